//! L41: the sign of the axial direction.

use nalgebra::Vector2;

use crate::aligned_scene::AlignedScene;
use crate::alignment::{self, Convention, Match};
use crate::flow::rigid::rigid_flow;
use crate::ledger::{Case, Claim, Findings, Trial, Verdict, taped};
use crate::loss_forms::axial;
use crate::losses::{AxialForm, LossOptions};
use crate::scenes;

pub(super) static CLAIM: Claim = Claim {
    id: "L41",
    slug: "laxi-sign",
    place: "eq. la",
    statement: "At the true motion the angle of eq. la between f_axi and p_t - p0 is zero.",
    verdict: Verdict::Fails,
    condition: Some("t'_z < 0: the source lies ahead of the target"),
    formula: "f_axi = -t'_z / (z + t'_z) d: the angle is 0 for t'_z < 0 and pi for t'_z > 0",
    derivation: "z + t'_z is positive, so the flow points along d for t'_z < 0 and against it for t'_z > 0.",
    counter_example: Some(
        "drive_prev (t'_z = 0.8 m): printed 3.14159 rad at the truth, sign-aware 0. drive_next (t'_z = -0.8 m): both 0.",
    ),
    correction: Some("Compare with -sign(t'_z) d, or take the angle between the lines."),
    functions: &[
        "loss_forms::axial::printed",
        "loss_forms::axial::pose_sign",
        "loss_forms::axial::folded",
        "loss_forms::axial::flow_sign",
    ],
    taped: &["losses::axial"],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    let f = &mut trial.findings;
    let options = LossOptions { convention: Convention::Consistent, ..taped::bare() };
    for (reference, expected) in [(scenes::drive_next(), 0.0), (scenes::drive_prev(), std::f64::consts::PI)] {
        let Some(seen) = AlignedScene::with_error(&reference, &[0.0; 6]) else {
            return f.residual("a reference in front of the camera", f64::NAN, 1.0);
        };
        let printed = axial::printed(&seen.axial, &seen.offsets);
        f.residual("printed loss of the references, documented, rad", printed - expected, 1e-9);
        forms(&seen.axial, &seen.offsets, seen.translation.z, f);
        let taped = |axial| taped::scene_losses(&reference.scene, &reference.motion, &LossOptions { axial, ..options })[1];
        // On the tape the arc cosine sees angles of the size of the root of rounding.
        f.residual("printed loss of the references on the tape, rad", taped(AxialForm::Literal) - expected, 1e-6);
        f.residual("sign-aware loss of the references on the tape, rad", taped(AxialForm::PoseSign), 1e-9);
    }
    trial.count(2 * scenes::road().pixels.len());
}

fn at(case: &Case, f: &mut Findings) {
    let (a, d) = (case.in_target(), [case.offset()]);
    if a.z.abs() <= 0.01 * case.depth || d[0].norm() <= 5.0 {
        return;
    }
    let aligned = rigid_flow(&case.camera, &case.motion, &case.pixel, case.depth).and_then(|(flow, source_depth)| {
        let m = Match { target: case.pixel, source: case.pixel + flow, source_depth };
        alignment::axial(&case.camera, &case.motion.rotation, &a, &m)
    });
    let Some(aligned) = aligned else { return f.residual("point in front of the camera", f64::NAN, 1.0) };
    forms(&[aligned.flow], &d, a.z, f);
}

/// All forms of the loss over exact axial flows.
fn forms(flows: &[Vector2<f64>], d: &[Vector2<f64>], a_z: f64, f: &mut Findings) {
    let expected = if a_z > 0.0 { std::f64::consts::PI } else { 0.0 };
    f.residual("printed angle - (0 or pi by the sign of t'_z), rad", axial::printed(flows, d) - expected, 1e-9);
    f.residual("sign-aware angle, rad", axial::pose_sign(flows, d, a_z), 1e-9);
    f.residual("angle by the sign of the flow, rad", axial::flow_sign(flows, d), 1e-9);
    f.residual("sign of the flow + sign of t'_z", axial::sign_of_flows(flows, d) + a_z.signum(), 0.0);
    f.residual("angle between the lines, rad", axial::folded(flows, d), 1e-9);
    f.residual("squared sine of the angle", axial::smooth(flows, d), 1e-18);
    if a_z > 0.0 {
        f.gap("printed angle for t'_z > 0, rad", axial::printed(flows, d), 3.1);
    }
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
        fn the_printed_angle_is_pi_for_every_backward_source(case in case()) {
            let case = if case.in_target().z < 0.0 { case.with_translation(-case.motion.translation) } else { case };
            prop_assume!(case.in_target().z > 0.01 * case.depth && case.offset().norm() > 5.0);
            let mut f = Findings::default();
            at(&case, &mut f);
            prop_assert!(f.findings().iter().any(|x| x.what.starts_with("printed angle for") && x.ok()));
        }
    }
}
