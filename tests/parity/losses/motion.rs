//! The four losses of rotation, tangential and radial motion, with every map and term behind them.

use dimode_autodiff::ops::bilinear_sample::SamplePadding;
use dimode_autodiff::{Scalar, Shape, Tape, Tensor, Var, pixel_grid};
use dimode_geometry::Convention;
use dimode_geometry::losses::{
    AlignedPair, Angles, AxialForm, LossOptions, LossTerm, PairInputs, PlanarForm, RadialForm, TangentialForm, axial,
    axial_angles, planar, planar_angles, radial, ratio_term, tangential,
};
use dimode_geometry::taped::pose::source_from_target;
use dimode_geometry::taped::{RotationForm, masks, translation_in_target_frame, warp};

use crate::compared::Compared;

const VECTOR: Shape = Shape([2, 3, 1, 1]);
const AXES: [&str; 3] = ["x", "y", "z"];

/// Inputs in the order of the stored gradients' names.
const LEAVES: [&str; 5] = ["flow", "depth_t", "depth_s", "axisangle", "translation"];

fn leaves<'t, T: Scalar>(c: &Compared<T>, tape: &'t Tape<T>) -> [Var<'t, T>; 5] {
    LEAVES.map(|name| {
        let stored = format!("in.{name}");
        match name {
            "axisangle" | "translation" => tape.leaf(c.vectors(&stored)),
            _ => c.leaf(tape, &stored),
        }
    })
}

fn pair<'t, T: Scalar>(c: &Compared<T>, v: &[Var<'t, T>; 5], options: &LossOptions) -> AlignedPair<'t, T> {
    let pose = source_from_target(v[3], v[4], false, RotationForm::Guarded);
    let inputs = PairInputs {
        target_depth: v[1],
        source_depth: v[2],
        flow: v[0],
        rotation: pose.rotation,
        translation: pose.translation,
        intrinsics: &c.cameras(),
        mask: &c.map("in.mask"),
    };
    AlignedPair::new(&inputs, options)
}

fn terms<'t, T: Scalar>(pair: &AlignedPair<'t, T>, options: &LossOptions) -> [(&'static str, LossTerm<'t, T>); 4] {
    [
        ("L_pla", planar(pair, options)),
        ("L_axi", axial(pair, options)),
        ("L_tan", tangential(pair, options)),
        ("L_rad", radial(pair, options)),
    ]
}

/// The depth read at the flow's end has a kink where that is a whole row or column, and either of its one-sided derivatives is
/// right. Both components of such a flow are left out, at most a tenth of all.
fn on_a_kink<T: Scalar>(c: &Compared<T>) -> Vec<bool> {
    let flow = c.map("in.flow");
    let whole = |n: usize, k: usize, h: usize, w: usize| {
        let x = flow.at(n, k, h, w).to_f64();
        (x - x.round()).abs() < 1e-9
    };
    let kinks = Tensor::<f64>::from_fn(flow.shape(), |n, _, h, w| f64::from(u8::from(whole(n, 0, h, w) || whole(n, 1, h, w))));
    let kinks: Vec<bool> = kinks.data().iter().map(|&k| k != 0.0).collect();
    assert!(10 * kinks.iter().filter(|&&k| k).count() < kinks.len());
    kinks
}

fn check_values_and_gradients<T: Scalar>(c: &Compared<T>, row: &str, options: &LossOptions) {
    let (tape, kinks) = (Tape::new(), on_a_kink(c));
    let v = leaves(c, &tape);
    let pair = pair(c, &v, options);
    for (name, term) in terms(&pair, options) {
        c.matches(&format!("out.{row}.{name}"), &term.per_image.value());
        let grads = tape.backward(term.mean);
        c.matches_except(&format!("grad.{row}.{name}.flow"), &grads.wrt(v[0]), |i| kinks[i]);
        let others: Vec<_> = LEAVES.into_iter().zip(v).skip(1).collect();
        c.gradients_match(&format!("grad.{row}.{name}"), &grads, &others);
    }
    for (axis, name) in AXES.into_iter().enumerate() {
        let term = ratio_term(&pair, options, axis);
        c.matches(&format!("out.{row}.A_{name}"), &term.pixel_error.value());
        c.matches(&format!("out.{row}.C_{name}"), &term.aggregate_error.value());
        c.matches(&format!("out.{row}.rec_{name}"), &term.recovered.value());
    }
    for (name, angles) in [("theta_pla", planar_angles(&pair, options)), ("theta_axi", axial_angles(&pair, options))] {
        let Angles { angle, mask } = angles.expect("a form with angles");
        c.matches(&format!("out.{row}.{name}"), &inside(angle, &mask));
    }
}

/// The map with 0 outside the mask, as it is stored.
fn inside<T: Scalar>(x: Var<'_, T>, mask: &Tensor<T>) -> Tensor<T> {
    x.select(mask, x.tape().constant(Tensor::zeros(x.shape()))).value()
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

/// Source depth at the flow's end, and the point that it makes of that end: `p_s`, `D_st`, `D_st K^-1 p_s`.
fn check_correspondence<T: Scalar>(c: &Compared<T>, rows: &[&str]) {
    let tape = Tape::new();
    let (flow, depth) = (c.leaf(&tape, "in.flow"), c.leaf(&tape, "in.depth_s"));
    let at_source = warp(depth, flow, SamplePadding::Border).value();
    c.matches("out.D_st", &at_source);
    let ends = flow.add(tape.constant(pixel_grid(flow.shape()))).value();
    let cameras = c.cameras();
    let points = Tensor::from_fn(Shape::new(2, 3, 24, 32), |n, k, h, w| {
        let ray = cameras[n].ray(ends.at(n, 0, h, w).to_f64(), ends.at(n, 1, h, w).to_f64());
        at_source.at(n, 0, h, w) * T::from_f64(ray[k])
    });
    for row in rows {
        c.matches(&format!("out.{row}.p_s"), &ends);
        c.matches(&format!("out.{row}.P_s"), &points);
    }
}

fn check_printed_maps<T: Scalar>(c: &Compared<T>, row: &str, options: &LossOptions) {
    let tape = Tape::new();
    let v = leaves(c, &tape);
    let pair = pair(c, &v, options);
    for (name, map) in [
        ("f_pla", pair.planar_flow),
        ("f_axi", pair.axial_flow),
        ("z_pla", pair.planar_depth),
        ("z_axi", pair.axial_depth),
        ("t_used", pair.translation),
    ] {
        c.matches(&format!("out.{row}.{name}"), &map.value());
    }
    for (axis, name) in AXES.into_iter().enumerate() {
        let term = ratio_term(&pair, options, axis);
        c.matches(&format!("out.{row}.rho_{name}"), &inside(term.ratio, &term.pixels));
    }
}

/// Means over the batch, the weighted sum of stage 3, and the variance over `N - 1`.
fn check_sums<T: Scalar>(c: &Compared<T>, row: &str, options: &LossOptions) {
    let tape = Tape::new();
    let v = leaves(c, &tape);
    let terms = terms(&pair(c, &v, options), options);
    for (name, term) in &terms {
        c.matches(&format!("out.{row}.{name}_batch"), &term.mean.value());
    }
    let [pla, axi, tan, rad] = terms.each_ref().map(|(_, term)| term.mean);
    c.matches(&format!("out.{row}.stage3"), &axi.add(pla).scale(0.05).add(rad.add(tan).scale(0.1)).value());
    let planar = &terms[0].1;
    let variances = planar.per_image.value();
    let unbiased = variances
        .data()
        .iter()
        .zip(&planar.counts)
        .map(|(&variance, &count)| variance * T::from_f64(count as f64 / (count - 1) as f64));
    c.matches(&format!("out.{row}.L_pla_unbiased"), &Tensor::from_vec(Shape::new(2, 1, 1, 1), unbiased.collect()));
}

fn check_literal<T: Scalar>() {
    let c = Compared::<T>::open("dimode_literal");
    check_correspondence(&c, &["literal", "target"]);
    for (row, convention) in [("literal", Convention::AsPrinted), ("target", Convention::Consistent)] {
        let options = printed(convention);
        check_values_and_gradients(&c, row, &options);
        check_printed_maps(&c, row, &options);
        check_sums(&c, row, &options);
    }
    c.finish();
}

#[test]
fn printed_losses_in_both_conventions_and_precisions() {
    check_literal::<f64>();
    check_literal::<f32>();
}

fn check_masks<T: Scalar>(c: &Compared<T>, row: &str, options: &LossOptions) {
    let tape = Tape::new();
    let v = leaves(c, &tape);
    let pair = pair(c, &v, options);
    let mask = |name: &str, found: &Tensor<T>| c.mask_matches(&format!("out.{row}.{name}"), found);
    mask("m_base", &pair.mask);
    for (name, angles) in [("m_pla", planar_angles(&pair, options)), ("m_axi", axial_angles(&pair, options))] {
        mask(name, &angles.expect("a form with angles").mask);
    }
    assert_eq!(planar(&pair, options).counts, masks::counts(&c.map(&format!("out.{row}.m_pla"))), "{row}");
    assert_eq!(axial(&pair, options).counts, masks::counts(&c.map(&format!("out.{row}.m_axi"))), "{row}");
    for (axis, name) in AXES.into_iter().enumerate() {
        mask(&format!("m_{name}"), &ratio_term(&pair, options, axis).pixels);
    }
}

/// Whether the printed formulas of the four losses, without any guard, are finite on the mask of an image.
fn printed_is_finite<T: Scalar>(pair: &AlignedPair<'_, T>, mask: &Tensor<T>, camera: &[f64], n: usize) -> [bool; 4] {
    let (pla, axi) = (pair.planar_flow.value(), pair.axial_flow.value());
    let mut finite = [true; 4];
    for i in (0..mask.shape().plane()).filter(|&i| mask.plane(n, 0)[i] != T::ZERO) {
        let [f, g] = [&pla, &axi].map(|flow| [0, 1].map(|k| flow.plane(n, k)[i].to_f64()));
        let q = [(i % 32) as f64 - camera[2], (i / 32) as f64 - camera[5]];
        let along = q[0] * g[0] + q[1] * g[1];
        let square = q[0] * q[0] + q[1] * q[1];
        let angle = |along: f64, size: f64| (along / size).acos();
        let values = [
            angle(f[0], f[0].hypot(f[1])),
            angle(along, square.sqrt() * g[0].hypot(g[1])),
            1.0 / f[0] + 1.0 / f[1],
            (along + square) / along,
        ];
        finite.iter_mut().zip(values).for_each(|(finite, value)| *finite &= value.is_finite());
    }
    finite
}

fn check_robust<T: Scalar>() {
    let c = Compared::<T>::open("dimode_robust");
    check_correspondence(&c, &[]);
    for (row, convention, form) in [
        ("target_folded", Convention::Consistent, AxialForm::Folded),
        ("literal_signed", Convention::AsPrinted, AxialForm::Signed),
        ("target_pose_sign", Convention::Consistent, AxialForm::PoseSign),
    ] {
        let options = robust(convention, form);
        check_values_and_gradients(&c, row, &options);
        check_masks(&c, row, &options);
    }
    let tape = Tape::new();
    let v = leaves(&c, &tape);
    let pair = pair(&c, &v, &printed(Convention::AsPrinted));
    let (mask, k) = (c.map("in.mask"), c.golden().numbers("in.K"));
    let finite = [0, 1].map(|n| printed_is_finite(&pair, &mask, &k[9 * n..], n));
    let numbers = finite.concat().into_iter().map(|f| T::from_f64(f64::from(u8::from(f)))).collect();
    c.mask_matches("out.literal_finite", &Tensor::from_vec(Shape::new(2, 4, 1, 1), numbers));
    c.finish();
}

#[test]
fn robust_losses_and_their_masks_in_both_precisions() {
    check_robust::<f64>();
    check_robust::<f32>();
}

fn exact_pair<'t, T: Scalar>(c: &Compared<T>, tape: &'t Tape<T>, source: &str, options: &LossOptions) -> AlignedPair<'t, T> {
    let map = |name: &str| c.leaf(tape, &format!("in.{source}.{name}"));
    let inputs = PairInputs {
        target_depth: map("depth_t"),
        source_depth: map("depth_s_at_ps"),
        flow: map("flow"),
        rotation: tape.leaf(c.golden().tensor(&format!("in.{source}.R"), Shape::new(2, 1, 3, 3))),
        translation: tape.leaf(c.golden().tensor(&format!("in.{source}.t"), VECTOR)),
        intrinsics: &c.cameras(),
        mask: &c.map(&format!("in.{source}.mask")),
    };
    AlignedPair::from_sampled(&inputs, options)
}

/// The flows and the recovered translation of one convention on the exact scene.
fn check_exact_maps<T: Scalar>(c: &Compared<T>, source: &str, row: &str, options: &LossOptions) {
    let tape = Tape::new();
    let pair = exact_pair(c, &tape, source, options);
    c.matches(&format!("out.{source}.{row}.f_pla"), &pair.planar_flow.value());
    c.matches(&format!("out.{source}.{row}.f_axi"), &pair.axial_flow.value());
    let recovered = [0, 1, 2].map(|axis| ratio_term(&pair, options, axis).recovered);
    c.matches(&format!("out.{source}.{row}.recovered"), &Var::concat(&recovered, 1).value());
}

fn check_exact<T: Scalar>() {
    let c = Compared::<T>::open("dimode_exact");
    for source in ["next", "prev"] {
        let tape = Tape::new();
        let rotation = tape.leaf(c.golden().tensor(&format!("in.{source}.R"), Shape::new(2, 1, 3, 3)));
        let translation = tape.leaf(c.vectors(&format!("in.{source}.t")));
        c.matches(&format!("out.{source}.t_target_frame"), &translation_in_target_frame(rotation, translation).value());
        for (row, options) in [
            ("literal", printed(Convention::AsPrinted)),
            ("target", printed(Convention::Consistent)),
            ("robust", robust(Convention::Consistent, AxialForm::Folded)),
        ] {
            if row != "robust" {
                check_exact_maps(&c, source, row, &options);
            }
            for (name, term) in terms(&exact_pair(&c, &tape, source, &options), &options) {
                // What is 0 but for rounding is compared absolutely; an arccos next to cosine 1 keeps half of the digits, and a
                // variance is a square.
                let absolute = match (name, row) {
                    ("L_pla", _) => 1e-18,
                    ("L_axi", "robust") => 1e-10,
                    ("L_axi", _) => 5e-8,
                    _ => 1e-10,
                };
                c.nearly_matches(&format!("out.{source}.{row}.{name}"), &term.per_image.value(), absolute);
            }
        }
    }
    c.finish();
}

#[test]
fn the_exact_scene_costs_nothing_when_consistent_and_the_stored_amount_when_printed() {
    check_exact::<f64>();
    check_exact::<f32>();
}

#[test]
fn the_pixel_forms_cost_nothing_on_the_exact_scene() {
    // The stored flows carry a division guard of 1e-7, which is what remains.
    let options = LossOptions { min_tangential_share: 0.0, noise_pixels: 0.0, noise_share: 0.0, ..LossOptions::default() };
    let c = Compared::<f64>::open("dimode_exact");
    for source in ["next", "prev"] {
        let tape = Tape::new();
        for (name, term) in terms(&exact_pair(&c, &tape, source, &options), &options) {
            let values = term.per_image.value();
            assert!(values.data().iter().all(|x| x.abs() < 1e-7), "{source} {name}: {values:?}");
        }
    }
}
