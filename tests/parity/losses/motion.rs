//! The four losses of rotation, tangential and radial motion.

use crate::support::{cameras, close, open};
use dimode_autodiff::{Shape, Tape, Tensor, Var};
use dimode_geometry::Convention;
use dimode_geometry::losses::{
    AlignedPair, AxialForm, LossOptions, LossTerm, PairInputs, PlanarForm, RadialForm, TangentialForm, axial, planar, radial,
    tangential,
};
use dimode_geometry::taped::pose::source_from_target;
use dimode_geometry::taped::{RotationForm, masks};
use dimode_tests::Golden;

const VECTOR: Shape = Shape([2, 3, 1, 1]);

/// Inputs in the order of the stored gradients' names.
const LEAVES: [&str; 5] = ["flow", "depth_t", "depth_s", "axisangle", "translation"];

fn leaves<'t>(golden: &Golden, tape: &'t Tape<f64>) -> [Var<'t, f64>; 5] {
    LEAVES.map(|name| {
        let stored = format!("in.{name}");
        tape.leaf(match name {
            "axisangle" | "translation" => golden.tensor(&stored, VECTOR),
            _ => golden.map(&stored),
        })
    })
}

fn pair<'t>(golden: &Golden, v: &[Var<'t, f64>; 5], options: &LossOptions) -> AlignedPair<'t, f64> {
    let pose = source_from_target(v[3], v[4], false, RotationForm::Guarded);
    let inputs = PairInputs {
        target_depth: v[1],
        source_depth: v[2],
        flow: v[0],
        rotation: pose.rotation,
        translation: pose.translation,
        intrinsics: &cameras(golden),
        mask: &golden.map("in.mask"),
    };
    AlignedPair::new(&inputs, options)
}

fn terms<'t>(pair: &AlignedPair<'t, f64>, options: &LossOptions) -> [(&'static str, LossTerm<'t, f64>); 4] {
    [
        ("L_pla", planar(pair, options)),
        ("L_axi", axial(pair, options)),
        ("L_tan", tangential(pair, options)),
        ("L_rad", radial(pair, options)),
    ]
}

/// Gradients of the flow without the pixels whose flow ends on a whole row or column: the sampled depth
/// has a kink there, and either of its one-sided derivatives is right.
fn smooth_only(golden: &Golden, gradient: &[f64]) -> Vec<f64> {
    let flow = golden.map::<f64>("in.flow");
    let whole = |n: usize, i: usize, c: usize| {
        let x = flow.plane(n, c)[i];
        (x - x.round()).abs() < 1e-9
    };
    let plane = flow.shape().plane();
    let kept = |k: usize| {
        let (n, i) = (k / (2 * plane), k % plane);
        !(whole(n, i, 0) || whole(n, i, 1))
    };
    let chosen: Vec<f64> = (0..gradient.len()).filter(|&k| kept(k)).map(|k| gradient[k]).collect();
    assert!(chosen.len() > gradient.len() * 9 / 10);
    chosen
}

fn check_values_and_gradients(golden: &Golden, row: &str, options: &LossOptions) {
    let tape = Tape::new();
    let v = leaves(golden, &tape);
    let pair = pair(golden, &v, options);
    for (name, term) in terms(&pair, options) {
        let expected = golden.numbers(&format!("out.{row}.{name}"));
        close(&format!("{row} {name}"), term.per_image.value().data(), expected, 1e-12, 1e-9);
        let grads = tape.backward(term.mean);
        for (leaf, var) in LEAVES.iter().zip(v) {
            let expected = golden.numbers(&format!("grad.{row}.{name}.{leaf}"));
            let (found, expected) = match *leaf {
                "flow" => (smooth_only(golden, grads.wrt(var).data()), smooth_only(golden, expected)),
                _ => (grads.wrt(var).to_vec(), expected.to_vec()),
            };
            let scale = expected.iter().fold(0.0f64, |m, x| m.max(x.abs()));
            close(&format!("{row} {name} {leaf}"), &found, &expected, 1e-9 * scale + 1e-13, 1e-8);
        }
    }
}

fn printed(convention: Convention) -> LossOptions {
    LossOptions { convention, min_valid_share: 0.0, ..LossOptions::literal() }
}

/// The printed quantities with their hazards masked.
fn robust(convention: Convention, axial: AxialForm) -> LossOptions {
    LossOptions {
        axial,
        planar: PlanarForm::Robust,
        tangential: TangentialForm::Robust,
        radial: RadialForm::Robust,
        ..printed(convention)
    }
}

#[test]
fn printed_losses_in_both_conventions() {
    let golden = open("dimode_literal");
    check_values_and_gradients(&golden, "literal", &printed(Convention::AsPrinted));
    check_values_and_gradients(&golden, "target", &printed(Convention::Consistent));
}

#[test]
fn aligned_maps_match() {
    let golden = open("dimode_literal");
    for (row, convention) in [("literal", Convention::AsPrinted), ("target", Convention::Consistent)] {
        let tape = Tape::new();
        let v = leaves(&golden, &tape);
        let pair = pair(&golden, &v, &printed(convention));
        for (name, var) in [
            ("f_pla", pair.planar_flow),
            ("f_axi", pair.axial_flow),
            ("z_pla", pair.planar_depth),
            ("z_axi", pair.axial_depth),
            ("t_used", pair.translation),
        ] {
            let expected = golden.numbers(&format!("out.{row}.{name}"));
            close(&format!("{row} {name}"), var.value().data(), expected, 1e-10, 1e-11);
        }
    }
}

#[test]
fn robust_losses_and_their_masks() {
    let golden = open("dimode_robust");
    for (row, convention, form) in [
        ("target_folded", Convention::Consistent, AxialForm::Folded),
        ("literal_signed", Convention::AsPrinted, AxialForm::Signed),
        ("target_pose_sign", Convention::Consistent, AxialForm::PoseSign),
    ] {
        let options = robust(convention, form);
        check_values_and_gradients(&golden, row, &options);
        let tape = Tape::new();
        let v = leaves(&golden, &tape);
        let pair = pair(&golden, &v, &options);
        let stored = |name: &str| golden.map::<f64>(&format!("out.{row}.{name}"));
        assert_eq!(pair.mask.to_vec(), stored("m_base").to_vec(), "{row}");
        assert_eq!(planar(&pair, &options).counts, masks::counts(&stored("m_pla")), "{row}");
        assert_eq!(axial(&pair, &options).counts, masks::counts(&stored("m_axi")), "{row}");
    }
}

fn exact_values(golden: &Golden, source: &str, options: &LossOptions) -> [Vec<f64>; 4] {
    let tape = Tape::new();
    let map = |name: &str| tape.leaf(golden.map(&format!("in.{source}.{name}")));
    let mask: Tensor<f64> = golden.map(&format!("in.{source}.mask"));
    let inputs = PairInputs {
        target_depth: map("depth_t"),
        source_depth: map("depth_s_at_ps"),
        flow: map("flow"),
        rotation: tape.leaf(golden.tensor(&format!("in.{source}.R"), Shape::new(2, 1, 3, 3))),
        translation: tape.leaf(golden.tensor(&format!("in.{source}.t"), VECTOR)),
        intrinsics: &cameras(golden),
        mask: &mask,
    };
    let pair = AlignedPair::from_sampled(&inputs, options);
    terms(&pair, options).map(|(_, t)| t.per_image.value().to_vec())
}

#[test]
fn exact_scene_costs_nothing_when_consistent_and_the_stored_amount_when_printed() {
    let golden = open("dimode_exact");
    for source in ["next", "prev"] {
        let names = ["L_pla", "L_axi", "L_tan", "L_rad"];
        for (row, convention) in [("literal", Convention::AsPrinted), ("target", Convention::Consistent)] {
            let found = exact_values(&golden, source, &printed(convention));
            for (name, values) in names.iter().zip(found) {
                let expected = golden.numbers(&format!("out.{source}.{row}.{name}"));
                // An arccos next to cosine 1 cannot be better than the root of the rounding error.
                close(&format!("{source} {row} {name}"), &values, expected, 5e-8, 1e-8);
            }
        }
        // The stored flows carry a division guard of 1e-7, which is what remains.
        let pixels = LossOptions { min_tangential_share: 0.0, noise_pixels: 0.0, noise_share: 0.0, ..LossOptions::default() };
        for options in [robust(Convention::Consistent, AxialForm::Folded), pixels] {
            for (name, values) in names.iter().zip(exact_values(&golden, source, &options)) {
                assert!(values.iter().all(|x| x.abs() < 1e-7), "{source} {name}: {values:?}");
            }
        }
    }
}
