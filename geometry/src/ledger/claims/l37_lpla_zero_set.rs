//! L37: what eq. `lp` is zero for.

use dimode_autodiff::{Shape, Tape, Tensor};
use nalgebra::{Vector2, Vector3};

use crate::aligned_scene::AlignedScene;
use crate::ledger::{Case, Claim, Findings, Trial, Verdict, taped};
use crate::loss_forms::planar;
use crate::losses::{self, LossOptions, PlanarForm};
use crate::scenes::{self, Reference};

pub(super) static CLAIM: Claim = Claim {
    id: "L37",
    slug: "lpla-zero-set",
    place: "eq. lp",
    statement: "L_pla, the variance of arccos(e_1 . f / |f|), vanishes exactly when the planar flows are parallel.",
    verdict: Verdict::Fails,
    condition: None,
    formula: "arccos(f_u / |f|) = |atan2(f_v, f_u)|: L_pla = 0 exactly when all directions are alpha or -alpha for one alpha \
              in [0, pi]",
    derivation: "arccos of a cosine is the angle without its sign. Two flows mirrored about e_1 have one angle, and so have \
                 two opposite vertical flows (pi/2 and -pi/2). A symmetric spread about e_1 is folded: uniform angles in [-s, \
                 s] have the variance s^2/3, their magnitudes s^2/12; for normal angles the share is 1 - 2/pi.",
    counter_example: Some(
        "Mirrored flows (1, .5), (1, -.5), (2, 1), (.4, -.2): printed 0, circular 0.211146. Antiparallel flows (0, 1), (0, \
         -2), (0, .5), (0, -1.5): printed 0, circular 2. A fan of 11 directions costs 0.0219 about the horizontal axis and \
         0.0897 about the vertical one; in the room with t' = (0.12, 0, 0.02) and t'_z 20 % too large 1.186e-05 against \
         4.787e-05.",
    ),
    correction: Some(
        "Circular variance 2 (1 - |E[f / |f|]|): zero exactly for parallel flows of one orientation, in every direction alike.",
    ),
    functions: &["loss_forms::planar::printed", "loss_forms::planar::circular", "loss_forms::planar::weighted"],
    taped: &["losses::planar"],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    let f = &mut trial.findings;
    mirrored_and_opposite(f);
    fans(f);
    let (printed, circular) = scaled_translation(Vector3::new(0.12, 0.0, 0.02), 1.2);
    f.documented("room, t'_z 20 % too large, printed, documented", printed, 1.18624285774e-05, 1e-9);
    f.documented("room, t'_z 20 % too large, circular, documented", circular, 4.7866545077599944e-05, 1e-9);
    f.gap("room: circular over printed", circular / printed, 3.6);
}

fn list<const N: usize>(flows: [[f64; 2]; N]) -> Vec<Vector2<f64>> {
    flows.into_iter().map(Vector2::from).collect()
}

fn mirrored_and_opposite(f: &mut Findings) {
    let mirror = list([[1.0, 0.5], [1.0, -0.5], [2.0, 1.0], [0.4, -0.2]]);
    let opposite = list([[0.0, 1.0], [0.0, -2.0], [0.0, 0.5], [0.0, -1.5]]);
    for (flows, circular) in [(mirror, 0.211145618), (opposite, 2.0)] {
        for (form, plain) in [(PlanarForm::Literal, planar::printed(&flows)), (PlanarForm::Circular, planar::circular(&flows))] {
            f.residual("flows that are not parallel: loss on the tape - plain", on_the_tape(&flows, form) - plain, 1e-13);
        }
        f.residual("printed loss of flows that are not parallel", planar::printed(&flows), 1e-13);
        f.documented("circular loss of flows that are not parallel, documented", planar::circular(&flows), circular, 1e-8);
        f.gap("circular - printed loss of flows that are not parallel", planar::circular(&flows) - planar::printed(&flows), 1.9);
    }
}

/// The loss on the tape, the flows being the pixels of one image.
fn on_the_tape(flows: &[Vector2<f64>], form: PlanarForm) -> f64 {
    let (options, camera) = (LossOptions { planar: form, ..taped::bare() }, scenes::kitti640());
    let tape = Tape::new();
    let image = tape.leaf(Tensor::from_fn(Shape::new(1, 2, 1, flows.len()), |_, c, _, i| flows[i][c]));
    losses::planar(&taped::still_pair(image, [0.0; 3], &[camera], &options), &options).mean.value().item()
}

/// Directions spread alike about the horizontal and about the vertical axis.
fn fans(f: &mut Findings) {
    let fan = |axis: usize| -> Vec<Vector2<f64>> {
        let one = |i: i32| [[1.0, 0.1 * f64::from(i)], [0.1 * f64::from(i), 1.0]][axis];
        (-5..=5).map(|i| Vector2::from(one(i))).collect()
    };
    let [about_u, about_v] = [0, 1].map(|axis| planar::printed(&fan(axis)));
    f.documented("fan about the horizontal axis, documented", about_u, 0.0218923311636, 1e-11);
    f.documented("fan about the vertical axis, documented", about_v, 0.0897454761346, 1e-11);
    f.residual("circular: one fan - the other", planar::circular(&fan(0)) - planar::circular(&fan(1)), 1e-12);
    f.gap("printed: vertical over horizontal fan", about_v / about_u, 3.6);
    // Limits of many angles; what is left belongs to the finite lists.
    let misses = [kept(&uniform()) - 0.25, kept(&normal()) - (1.0 - 2.0 / std::f64::consts::PI)].map(f64::abs);
    f.bound("2000 even angles: |share kept about the horizontal axis - 1/4|", misses[0], 1e-6);
    f.bound("normal angles: |share kept about the horizontal axis - (1 - 2/pi)|", misses[1], 1e-3);
}

/// Printed over unfolded variance of small angles.
fn kept(angles: &[f64]) -> f64 {
    let flows: Vec<_> = angles.iter().map(|a| Vector2::new(a.cos(), a.sin())).collect();
    planar::printed(&flows) / planar::unfolded(&flows)
}

/// 2000 angles evenly in [-0.01, 0.01].
fn uniform() -> Vec<f64> {
    (0..2000).map(|i| 0.01 * ((f64::from(i) + 0.5) / 1000.0 - 1.0)).collect()
}

/// Angles whose numbers follow the normal density of deviation 0.01, out to five deviations.
fn normal() -> Vec<f64> {
    let copies = |x: f64| (1000.0 * (-0.5 * x * x).exp()).round() as usize;
    (-250..250)
        .flat_map(|i| {
            let x = (f64::from(i) + 0.5) / 50.0;
            std::iter::repeat_n(0.01 * x, copies(x))
        })
        .collect()
}

/// Printed and circular loss in the room without rotation, when `t'_z` is taken `factor` times too large.
fn scaled_translation(in_target: Vector3<f64>, factor: f64) -> (f64, f64) {
    let reference = Reference { name: "shift", scene: scenes::room(), motion: scenes::motion([0.0; 3], in_target.into()) };
    let error = [0.0, 0.0, 0.0, 0.0, 0.0, (factor - 1.0) * in_target.z];
    let seen = AlignedScene::with_error(&reference, &error);
    seen.map_or((f64::NAN, f64::NAN), |s| (planar::printed(&s.planar), planar::circular(&s.planar)))
}

/// Five random flows, some of them mirrored; flows along one line and its mirror image.
fn at(case: &Case, f: &mut Findings) {
    let flows: Vec<_> = (0..5).map(|i| case.extra_flow(2 * i)).collect();
    let pick = (case.extra[10] * 32.0) as usize;
    let mirror = |flows: &[Vector2<f64>]| -> Vec<Vector2<f64>> {
        flows.iter().enumerate().map(|(i, f)| if pick >> i & 1 == 1 { Vector2::new(f.x, -f.y) } else { *f }).collect()
    };
    f.residual(
        "printed loss - the same after some flows were mirrored, rad^2",
        planar::printed(&flows) - planar::printed(&mirror(&flows)),
        1e-13,
    );
    let along: Vec<_> = flows.iter().map(|f| flows[0] * (f.norm() / flows[0].norm())).collect();
    f.residual("printed loss of directions alpha and -alpha, rad^2", planar::printed(&mirror(&along)), 1e-13);
    f.residual("circular loss of parallel flows", planar::circular(&along), 1e-13);
    let share = pick.count_ones() as f64 / 5.0;
    let expected = spread_of_two(flows[0].y.atan2(flows[0].x), share);
    f.residual(
        "circular loss of directions alpha and -alpha - 2 (1 - |mean|)",
        planar::circular(&mirror(&along)) - expected,
        1e-12,
    );
}

/// Circular variance when the share `s` of the directions is `-alpha`, the rest `alpha`.
fn spread_of_two(alpha: f64, s: f64) -> f64 {
    2.0 * (1.0 - alpha.cos().hypot((1.0 - 2.0 * s) * alpha.sin()))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::ledger::testing::{case, holds, limit};

    proptest! {
        #[test]
        fn holds_everywhere(case in case()) {
            holds(|f| at(&case, f))?;
        }

        #[test]
        fn holds_at_the_limits(case in limit()) {
            holds(|f| at(&case, f))?;
        }

        #[test]
        fn both_forms_agree_only_off_the_axis(y in 0.01f64..0.05, factor in 1.1f64..1.4) {
            let (printed, circular) = scaled_translation(Vector3::new(0.12, y + 0.01, 0.02), factor);
            prop_assert!((printed / circular - 1.0).abs() < 1e-3, "{printed} {circular}");
            let (printed, circular) = scaled_translation(Vector3::new(0.12, 0.0, 0.02), factor);
            prop_assert!(printed < 0.3 * circular);
        }
    }
}
