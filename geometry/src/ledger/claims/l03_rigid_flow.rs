//! L03: flow of a static scene under a rigid motion.

use nalgebra::{Vector2, Vector3};

use crate::flow::rigid::{printed_correspondence, rigid_flow};
use crate::ledger::{Case, Claim, Findings, Trial, Verdict, forward, taped};
use crate::{Se3, scenes, so3};

pub(super) static CLAIM: Claim = Claim {
    id: "L03",
    slug: "rigid-flow",
    place: "eq. p_s",
    statement: "p~_s = (1 / z_s) K (z_t R K^-1 p~_t + t), with z_s the source depth that the network predicts at p_s.",
    verdict: Verdict::Conditional,
    condition: Some("z_s is the depth of the transformed point, z_s = e_3 . (z_t R b + t) > 0"),
    formula: "p_s = pi(z_t R b(p_t) + t),  f = p_s - p_t",
    derivation: "K b = p~, so K P = z p~ for a point P of depth z at pixel p. Hence K (R P_t + t) = z_s p~_s with the depth z_s \
                 of that very point; any other divisor z_hat leaves the third component z_s / z_hat. The prediction at p_s is \
                 no way out: p_s is known only after the division.",
    counter_example: Some(
        "K of kitti640, omega = (0.02, -0.03, 0.01), t = (0.3, -0.1, 0.6), p = (451, 63), z = 12.5: p_s = (442.221, 56.135), \
         z_s = 13.2024. With z_hat 10 % too high the printed vector is (402.019, 51.031, 0.909).",
    ),
    correction: Some("Divide by the third component of the vector, and mask pixels where it is not positive."),
    functions: &["flow::rigid::rigid_flow", "flow::rigid::printed_correspondence"],
    taped: &["taped::rigid_flow", "taped::so3_exp"],
    missing_way: None,
    check,
};

const OMEGA: [f64; 3] = [0.02, -0.03, 0.01];

fn check(trial: &mut Trial) {
    trial.cases(at);
    let (camera, p) = (scenes::kitti640(), Vector2::new(451.0, 63.0));
    let motion = Se3::from_rotation_vector(&OMEGA.into(), Vector3::new(0.3, -0.1, 0.6));
    let (flow, depth) = rigid_flow(&camera, &motion, &p, 12.5).unwrap_or((Vector2::repeat(f64::NAN), f64::NAN));
    let f = &mut trial.findings;
    f.documented("p_s, documented", (p + flow).x, 442.221149965, 1e-11);
    f.documented("p_s, documented", (p + flow).y, 56.1345809123, 1e-11);
    f.documented("z_s, documented", depth, 13.2024207032, 1e-11);
    let printed = printed_correspondence(&camera, &motion, &p, 12.5, 1.1 * depth);
    for (k, expected) in [402.019227241, 51.031437193, 0.909090909091].into_iter().enumerate() {
        f.documented("printed vector for z_hat = 1.1 z_s, documented", printed[k], expected, 1e-11);
    }
    f.gap("printed for z_hat = 1.1 z_s: third component - 1", printed.z - 1.0, 0.09);
    f.gap("printed for z_hat = 1.1 z_s: first two components - p_s, px", (printed.xy() - (p + flow)).norm(), 40.0);
}

fn at(case: &Case, f: &mut Findings) {
    let (camera, motion, p, z) = (&case.camera, &case.motion, case.pixel, case.depth);
    let Some((flow, depth)) = rigid_flow(camera, motion, &p, z) else {
        return f.residual("point in front of the source camera", f64::NAN, 1.0);
    };
    let omega = so3::log(&motion.rotation);
    let (other, other_depth) = forward::rigid_flow::<f64>(camera, omega.into(), motion.translation.into(), p.into(), z);
    f.residual("flow - flow written out, px", (flow - Vector2::from(other)).norm(), 1e-10);
    f.equal("source depth - depth written out, relative", depth, other_depth, z, 1e-13);
    let (taped, _) = taped::rigid_flow(camera, &omega, &motion.translation, &p, z);
    f.residual("flow - flow on the tape, px", (flow - Vector2::new(taped[0], taped[1])).norm(), 1e-10);
    f.equal("source depth - depth on the tape, relative", depth, taped[2], z, 1e-13);
    let printed = |predicted| printed_correspondence(camera, motion, &p, z, predicted);
    f.residual("printed with z_hat = z_s: third component - 1", printed(depth).z - 1.0, 1e-14);
    f.residual("printed with z_hat = z_s: pixel - p_s, px", (printed(depth).xy() - (p + flow)).norm(), 1e-10);
    let share = case.extra(0, 0.5, 1.5);
    let wrong = printed(share * depth);
    f.residual("printed with any z_hat: third component - z_s / z_hat", wrong.z - 1.0 / share, 1e-13);
    f.residual(
        "printed with any z_hat, divided by its third component - p_s, px",
        (wrong.xy() / wrong.z - (p + flow)).norm(),
        1e-10,
    );
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
    }

    #[test]
    fn points_behind_the_source_camera_have_no_flow_and_no_derivative() {
        let (camera, p, t) = (scenes::kitti640(), Vector2::new(451.0, 63.0), Vector3::new(0.0, 0.0, -13.0));
        assert!(rigid_flow(&camera, &Se3 { translation: t, ..Se3::identity() }, &p, 12.5).is_none());
        let (values, rows) = taped::rigid_flow(&camera, &Vector3::zeros(), &t, &p, 12.5);
        assert_eq!(values, [0.0, 0.0, -0.5]);
        assert!(rows[..2].iter().flatten().all(|&slope| slope == 0.0));
    }
}
