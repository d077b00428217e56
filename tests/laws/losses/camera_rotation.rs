//! A rotation added to the source camera changes nothing where rotations are taken out exactly.
//!
//! The source view is turned by `dR`: `R' = dR R`, `t' = dR t`, every match ends where the turned camera sees its point, and the
//! point's depth is that in the turned camera. The scene may be as wrong as it likes: only the frame has changed.

use dimode::losses::contextual_geometric::{
    ContextualForm, ContextualInputs, TriangulatedForm, radial_depth, triangulated_depth,
};
use dimode_autodiff::{Tape, Tensor};
use dimode_geometry::losses::{AlignedPair, LossOptions, PairInputs, axial, planar, radial, tangential};
use dimode_geometry::taped::pose::pose_tensors;
use dimode_geometry::{Convention, Se3};

use crate::geometric::forms;
use crate::scenes::{bent, cameras, maps, mask, motion, motions, plane, seen, shifted};

/// Matches with the source depth at their ends.
struct Matches {
    depth: Tensor<f64>,
    source_depth: Tensor<f64>,
    flow: Tensor<f64>,
    motions: Vec<Se3>,
}

/// Planes with errors in depth, flow and motion.
fn matches(size: f64) -> Matches {
    let truth = motions(-1.0);
    let normals = vec![nalgebra::Vector3::new(0.2, -0.3, 1.0); 3];
    let depth = plane(&normals, &[6.0, 5.0, 7.0], &cameras());
    let [flow, source_depth] = seen(&depth, &truth, &cameras());
    let motions = truth.iter().map(|m| Se3 { translation: m.translation * (1.0 + size), ..*m }).collect();
    Matches {
        depth: bent(&depth, 1, size),
        source_depth: bent(&source_depth, 2, size),
        flow: shifted(&flow, 3, 4.0 * size),
        motions,
    }
}

/// The same seen by a source camera that is turned.
fn turned(m: &Matches, by: [f64; 3]) -> Matches {
    let turn = motion(by, [0.0; 3]);
    let k = cameras();
    let seen = |n: usize, v: usize, u: usize| {
        let at = [(u as f64) + m.flow.at(n, 0, v, u), (v as f64) + m.flow.at(n, 1, v, u)];
        let point = turn.rotation * k[n].ray(at[0], at[1]) * m.source_depth.at(n, 0, v, u);
        let p = k[n].project(&point).expect("in front of the turned camera");
        [p.x - u as f64, p.y - v as f64, point.z]
    };
    let part = |c: usize| Tensor::from_fn(maps(3), |n, _, v, u| seen(n, v, u)[c]);
    let flow = Tensor::from_fn(maps(3).with_c(2), |n, c, v, u| seen(n, v, u)[c]);
    Matches { depth: m.depth.clone(), source_depth: part(2), flow, motions: m.motions.iter().map(|m| turn * *m).collect() }
}

/// The four losses of every image.
fn losses(m: &Matches, options: &LossOptions) -> [Vec<f64>; 4] {
    let tape = Tape::new();
    let (r, t) = pose_tensors(&m.motions);
    let pair = AlignedPair::from_sampled(
        &PairInputs {
            target_depth: tape.constant(m.depth.clone()),
            source_depth: tape.constant(m.source_depth.clone()),
            flow: tape.constant(m.flow.clone()),
            rotation: tape.constant(r),
            translation: tape.constant(t),
            intrinsics: &cameras(),
            mask: &mask(3, |_, _, _| true),
        },
        options,
    );
    [planar(&pair, options), axial(&pair, options), tangential(&pair, options), radial(&pair, options)]
        .map(|term| term.per_image.value().to_vec())
}

const TURNS: [[f64; 3]; 3] = [[0.0, 0.035, 0.0], [0.03, -0.02, 0.05], [-0.2, 0.15, 0.1]];

#[test]
fn the_four_losses_do_not_see_it() {
    let seen = matches(0.05);
    for options in forms() {
        // What the flow's own error may cause is a share of the flow, which the rotation changes.
        let options = LossOptions { noise_share: 0.0, ..options };
        let before = losses(&seen, &options);
        for turn in TURNS {
            let after = losses(&turned(&seen, turn), &options);
            for (a, b) in before.iter().flatten().zip(after.iter().flatten()) {
                assert!((a - b).abs() < 1e-9 * (1.0 + a.abs()), "{turn:?}, {options:?}: {before:?} {after:?}");
            }
            assert!(before.iter().all(|b| b.iter().any(|&x| x > 1e-4)), "{options:?}: {before:?} shows nothing");
        }
    }
}

#[test]
fn in_the_printed_convention_they_do() {
    let seen = matches(0.05);
    for options in forms() {
        let options = LossOptions { noise_share: 0.0, convention: Convention::AsPrinted, ..options };
        let (before, after) = (losses(&seen, &options), losses(&turned(&seen, TURNS[0]), &options));
        let change: Vec<f64> = before
            .iter()
            .zip(&after)
            .map(|(a, b)| {
                let worst = a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                worst / a.iter().copied().fold(0.0, f64::max)
            })
            .collect();
        println!(
            "two degrees of yaw change {:?} {:?} {:?} {:?} by {change:.3?}",
            options.planar, options.axial, options.tangential, options.radial
        );
        assert!(change.iter().all(|&c| c > 1e-3), "{options:?}: {change:?}");
    }
}

/// Relative depth errors of both contextual losses: means over the batch.
fn contextual(m: &Matches) -> [f64; 2] {
    let tape = Tape::new();
    let (r, t) = pose_tensors(&m.motions);
    let still: Vec<_> = m.motions.iter().map(|m| Se3 { translation: nalgebra::Vector3::zeros(), ..*m }).collect();
    let [rotational, _] = seen(&m.depth, &still, &cameras());
    let inputs = ContextualInputs {
        flow: tape.constant(m.flow.clone()),
        depth: tape.constant(m.depth.clone()),
        rotation: tape.constant(r),
        translation: tape.constant(t),
        rotational: &rotational,
        intrinsics: &cameras(),
    };
    [radial_depth(&inputs, ContextualForm::Corrected), triangulated_depth(&inputs, TriangulatedForm::Corrected)]
        .map(|gated| gated.mean.value().item())
}

/// An exact scene of a camera that moves along its axis without turning.
fn along_the_axis() -> Matches {
    let motions = vec![motion([0.0; 3], [0.0, 0.0, -0.6]); 3];
    let depth = plane(&[nalgebra::Vector3::new(0.2, -0.3, 1.0); 3], &[6.0, 5.0, 7.0], &cameras());
    let [flow, source_depth] = seen(&depth, &motions, &cameras());
    Matches { depth, source_depth, flow, motions }
}

#[test]
fn triangulated_depth_stays_exact_and_radial_depth_does_not() {
    let exact = along_the_axis();
    let [radial, triangulated] = contextual(&exact);
    // The pixel on a principal point has no radial flow: its depth is 0 and its error 1.
    let blind = 1.0 / maps(3).len() as f64;
    assert!((radial - blind).abs() < 1e-4 && triangulated < 1e-2, "{radial} {triangulated}");
    let mut last = radial;
    for yaw in [0.005, 0.01, 0.02, 0.035] {
        let [radial, triangulated] = contextual(&turned(&exact, [0.0, yaw, 0.0]));
        println!("yaw {yaw}: radial depth {radial:.4}, triangulated {triangulated:.2e}");
        assert!(triangulated < 1e-2, "{triangulated}");
        assert!(radial > last, "yaw {yaw}: {radial} after {last}");
        last = radial;
    }
}
