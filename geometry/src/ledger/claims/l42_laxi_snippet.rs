//! L42: eq. `la` over the two sources of a snippet.

use nalgebra::Vector3;

use crate::aligned_scene::AlignedScene;
use crate::ledger::{Case, Claim, Findings, Trial, Verdict};
use crate::loss_forms::axial;
use crate::scenes::{self, Reference};
use crate::se3::Se3;

pub(super) static CLAIM: Claim = Claim {
    id: "L42",
    slug: "laxi-snippet",
    place: "eq. la with three frames",
    statement: "Eq. la can be applied to both sources of a snippet of three frames.",
    verdict: Verdict::Fails,
    condition: Some("both sources lie ahead of the target (t'_z < 0), that is, the camera reverses between the frames"),
    formula: "t'_z of the previous and of the next frame have opposite signs: the mean of the two losses at the truth is pi/2",
    derivation: "If the motion M repeats, the next source is M and the previous one M^-1, whose translation in its target \
                 frame is -t = -R t': the third component keeps its size up to the rotation and changes its sign. By L41 one \
                 of the two angles is pi, the other 0.",
    counter_example: Some(
        "drive_next and drive_prev: (0 + pi) / 2 = 1.5708 rad at the truth. On KITTI 00-10 all 22952 triplets that move (0.05 \
         m at least) have t'_z > 0 for the previous and t'_z < 0 for the next frame.",
    ),
    correction: Some("The sign-aware or the unsigned angle: 0 for both sources."),
    functions: &["loss_forms::axial::printed", "loss_forms::axial::pose_sign", "aligned_scene::AlignedScene::with_error"],
    taped: &["losses::axial"],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(signs);
    let references = [scenes::drive_next(), scenes::drive_prev()];
    at(&references, &mut trial.findings);
    trial.count(2 * scenes::road().pixels.len());
    let [next, _] = &references;
    reversing(next, &mut trial.findings);
    for _ in 0..(trial.samples / 100).max(1) {
        let next = forward_motion(&std::array::from_fn(|_| trial.draw.unit()));
        at(&snippet(next), &mut trial.findings);
        trial.count(scenes::road().pixels.len());
    }
}

/// A motion of 0.2 to 2.2 m mostly along the axis, either way, with up to 0.05 rad of rotation about each axis.
fn forward_motion(x: &[f64; 6]) -> Se3 {
    let centred = |i: usize| 2.0 * x[i] - 1.0;
    let along = if x[2] < 0.5 { -0.2 - 4.0 * x[2] } else { 0.2 + 4.0 * (x[2] - 0.5) };
    let in_target = Vector3::new(0.1 * centred(0), 0.1 * centred(1), along);
    scenes::motion([0.05 * centred(3), 0.05 * centred(4), 0.05 * centred(5)], in_target.into())
}

/// Both sources of a camera that repeats its motion.
fn snippet(next: Se3) -> [Reference; 2] {
    let source = |name, motion| Reference { name, scene: scenes::road(), motion };
    [source("next", next), source("previous", next.inverse())]
}

/// Losses of both sources at the truth.
fn at(references: &[Reference; 2], f: &mut Findings) {
    let losses = references.each_ref().map(|reference| {
        let seen = AlignedScene::with_error(reference, &[0.0; 6])?;
        Some([axial::printed(&seen.axial, &seen.offsets), axial::pose_sign(&seen.axial, &seen.offsets, seen.translation.z)])
    });
    let [Some(next), Some(previous)] = losses else {
        return f.residual("scenes in front of the camera", f64::NAN, 1.0);
    };
    let mean = (next[0] + previous[0]) / 2.0;
    f.residual("printed mean over the two sources - pi/2, rad", mean - std::f64::consts::FRAC_PI_2, 1e-9);
    f.gap("printed mean over the two sources, rad", mean, 1.57);
    f.gap("the worse of the two sources, printed, rad", next[0].max(previous[0]), 3.1);
    f.residual("sign-aware mean over the two sources, rad", (next[1] + previous[1]) / 2.0, 1e-9);
}

/// A camera that moves ahead and back again: the condition under which the printed loss holds.
fn reversing(next: &Reference, f: &mut Findings) {
    let seen = AlignedScene::with_error(next, &[0.0; 6]);
    let both = seen.map_or(f64::NAN, |s| axial::printed(&s.axial, &s.offsets));
    f.residual("printed loss of either source of a camera that reverses, rad", both, 1e-9);
}

/// A repeated motion has opposite radial translations while the rotation cannot turn the tangential part into more.
fn signs(case: &Case, f: &mut Findings) {
    let next = case.motion;
    let (a, b) = (next.translation_in_from_frame(), next.inverse().translation_in_from_frame());
    let turned = crate::so3::angle(&next.rotation);
    f.residual(
        "translation of the inverse in its target frame + t, relative to |t|",
        (b + next.translation).norm() / next.translation.norm().max(1e-300),
        1e-12,
    );
    if a.z.abs() > turned * a.norm() {
        f.residual("sign of t'_z of the next + of the previous source", a.z.signum() + b.z.signum(), 0.0);
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::ledger::testing::{case, holds, limit};

    proptest! {
        #[test]
        fn signs_are_opposite_everywhere(case in case()) {
            holds(|f| signs(&case, f))?;
        }

        #[test]
        fn signs_are_opposite_at_the_limits(case in limit()) {
            holds(|f| signs(&case, f))?;
        }

        #[test]
        fn half_a_turn_is_left_on_average(x in prop::array::uniform6(0.0f64..1.0)) {
            let mut f = Findings::default();
            at(&snippet(forward_motion(&x)), &mut f);
            prop_assert!(f.violations().is_empty() && f.findings().iter().all(|x| x.ok()), "{:?}", f.findings());
        }
    }
}
