//! L43: what the printed axial loss does around the truth of a source behind the target.

use nalgebra::{Vector2, Vector3};

use crate::aligned_scene::AlignedScene;
use crate::ledger::{Claim, Findings, Trial, Verdict};
use crate::loss_forms::axial;
use crate::scenes::{self, Reference};
use crate::sensitivity::{axial_response, mean_magnitude};

pub(super) static CLAIM: Claim = Claim {
    id: "L43",
    slug: "laxi-repeller",
    place: "derived from eq. la",
    statement: "Descent on the printed L_axi leads to the true motion.",
    verdict: Verdict::Fails,
    condition: Some("t'_z < 0"),
    formula: "t'_z > 0: L = pi - |error| E[|J|] near the truth, its maximum, with a cusp; L -> pi/2 for an infinite tangential \
              error",
    derivation: "With an error e of t'_tan the axial flow is -(t'_z d + f o e) / z': the angle to d depends on neither depth \
                 nor rotation, and turns monotonically from 0 or pi toward the angle between d and -f o e. On pixels symmetric \
                 about p0 a pixel and its mirror image swap the roles of the two sources, so that equal errors cancel in the \
                 sum of the two.",
    counter_example: Some(
        "drive_prev, error of t'_x: 0 m 3.14159 rad, 0.01 m 3.12114, 0.1 m 2.93530, 0.5 m 2.13451, 2 m 1.62461, 100 m 1.57183: \
         descent drives the error to infinity. drive_next rises by the same amounts: their sum is pi throughout.",
    ),
    correction: Some("The sign-aware angle rises with the error for both sources."),
    functions: &["loss_forms::axial::printed", "loss_forms::axial::pose_sign", "sensitivity::axial_response"],
    taped: &["losses::axial"],
    missing_way: None,
    check,
};

/// Error of `t'_x` in metres, printed loss of drive_prev.
const SWEEP: [(f64, f64); 6] = [
    (0.0, std::f64::consts::PI),
    (0.01, 3.12113625973),
    (0.1, 2.93530112755),
    (0.5, 2.13450694765),
    (2.0, 1.62461241844),
    (100.0, 1.57183082522),
];

fn check(trial: &mut Trial) {
    sweep(&mut trial.findings);
    cusp(&mut trial.findings);
    trial.count(SWEEP.len() * scenes::road().pixels.len());
    for _ in 0..(trial.samples / 100).max(1) {
        let drawn = Descent::new(&std::array::from_fn(|_| trial.draw.unit()));
        at(&drawn, &mut trial.findings);
        trial.count(scenes::road().pixels.len());
    }
}

/// Printed and sign-aware loss with an error of `t'`.
fn losses(reference: &Reference, error: Vector3<f64>) -> Option<[f64; 2]> {
    let seen = AlignedScene::with_error(reference, &[0.0, 0.0, 0.0, error.x, error.y, error.z])?;
    let true_z = seen.translation.z - error.z;
    Some([axial::printed(&seen.axial, &seen.offsets), axial::pose_sign(&seen.axial, &seen.offsets, true_z)])
}

const NONE: [f64; 2] = [f64::NAN; 2];

fn sweep(f: &mut Findings) {
    let (next, previous) = (scenes::drive_next(), scenes::drive_prev());
    for (error, expected) in SWEEP {
        let error = Vector3::new(error, 0.0, 0.0);
        let (n, p) = (losses(&next, error).unwrap_or(NONE), losses(&previous, error).unwrap_or(NONE));
        f.documented("printed loss of drive_prev, error of t'_x, documented", p[0], expected, 1e-11);
        f.residual("printed losses of the two sources - pi, rad", n[0] + p[0] - std::f64::consts::PI, 1e-9);
        f.residual("sign-aware: one source - the other, rad", n[1] - p[1], 1e-9);
    }
    let at = |error| losses(&previous, Vector3::new(error, 0.0, 0.0)).unwrap_or(NONE)[0];
    f.gap("printed: loss at the truth - loss with t'_x 0.5 m off, rad", at(0.0) - at(0.5), 0.9);
    f.gap("printed: loss at the truth - loss with t'_x 100 m off, rad", at(0.0) - at(100.0), 1.41);
}

/// The slope on both sides of the truth: `-E[|J|]` printed, `+E[|J|]` with the sign.
fn cusp(f: &mut Findings) {
    let (reference, step) = (scenes::drive_prev(), 1e-5);
    let (scene, a) = (&reference.scene, reference.motion.translation_in_from_frame());
    let responses: Vec<_> =
        scene.pixels.iter().zip(&scene.depths).map(|(p, &z)| axial_response(&scene.camera, &a, p, z)).collect();
    let expected = mean_magnitude(&responses);
    for (k, slope) in [expected[3], expected[4]].into_iter().enumerate() {
        let side = |sign: f64| losses(&reference, Vector3::ith(k, sign * step)).unwrap_or(NONE);
        // The mean of both sides: terms of second order have opposite signs there.
        let rise = |i: usize, start: f64| ((side(1.0)[i] + side(-1.0)[i]) / 2.0 - start) / step;
        let misses = [rise(0, std::f64::consts::PI) / -slope, rise(1, 0.0) / slope].map(|x| (x - 1.0).abs());
        f.bound("printed, error of 1e-5 m: |slope at the truth / -E[|J|] - 1|", misses[0], 1e-5);
        f.bound("sign-aware, error of 1e-5 m: |slope at the truth / E[|J|] - 1|", misses[1], 1e-5);
    }
}

/// A backward source and a growing error of its tangential translation.
struct Descent {
    reference: Reference,
    direction: Vector2<f64>,
    sizes: [f64; 2],
}

impl Descent {
    /// `t'_z` of 0.2 to 2 m, rotation up to 0.03 rad about each axis, two errors of up to 0.5 m in one direction.
    fn new(x: &[f64; 7]) -> Self {
        let omega = [x[0], x[1], x[2]].map(|x| 0.06 * x - 0.03);
        let motion = scenes::motion(omega, [0.05 - 0.1 * x[0], 0.1 * x[1] - 0.05, 0.2 + 1.8 * x[3]]);
        let (sin, cos) = (std::f64::consts::TAU * x[4]).sin_cos();
        let small = 0.001 + 0.2 * x[5];
        let reference = Reference { name: "backward", scene: scenes::road(), motion };
        Self { reference, direction: Vector2::new(cos, sin), sizes: [small, small + 0.01 + 0.28 * x[6]] }
    }
}

/// Errors a millimetre apart change the loss by at least so much, rad.
const LEAST: f64 = 1e-5;

fn at(drawn: &Descent, f: &mut Findings) {
    let at = |size: f64| losses(&drawn.reference, Vector3::new(drawn.direction.x, drawn.direction.y, 0.0) * size).unwrap_or(NONE);
    let values = [at(0.0), at(drawn.sizes[0]), at(drawn.sizes[1])];
    for pair in values.windows(2) {
        f.floor("printed: fall of the loss when the error of a backward source grows, rad", pair[0][0] - pair[1][0], LEAST);
        f.floor("sign-aware: rise of the loss when the error of a backward source grows, rad", pair[1][1] - pair[0][1], LEAST);
    }
    f.residual(
        "printed + sign-aware loss of a backward source - pi, rad",
        values[2][0] + values[2][1] - std::f64::consts::PI,
        1e-9,
    );
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::ledger::testing::holds;

    proptest! {
        #[test]
        fn every_backward_source_repels(x in prop::array::uniform7(0.0f64..1.0)) {
            holds(|f| at(&Descent::new(&x), f))?;
        }

        #[test]
        fn without_rotation_as_well(x in prop::array::uniform7(0.0f64..1.0)) {
            holds(|f| at(&Descent::new(&[0.5, 0.5, 0.5, x[3], x[4], x[5], x[6]]), f))?;
        }
    }
}
