//! L17: flow of a whole translation.

use nalgebra::{Vector2, Vector3};

use crate::flow::gradients::{rigid_gradients, translational_gradients};
use crate::flow::radial::radial_flow;
use crate::flow::rigid::rigid_flow_by_parts;
use crate::flow::tangential::tangential_flow;
use crate::flow::translational::{flow_about_focus, flow_from_parts, focus_of_expansion, translational_flow};
use crate::homography::{rotation_homography, transfer};
use crate::ledger::{Case, Claim, Findings, Trial, Verdict, forward, taped};
use crate::{Se3, scenes, so3};

pub(super) static CLAIM: Claim = Claim {
    id: "L17",
    slug: "combined-flow",
    place: "unnumbered equation of the combined flow",
    statement: "f = [f o t - d t_z] / (z_t + t_z).",
    verdict: Verdict::Exact,
    condition: Some("R = I; with a rotation p_R and z_R take the place of p_t and z_t, and p_R - p_t is added"),
    formula: "f = [f o t - d t_z] / (z_t + t_z) = z_t / (z_t + t_z) f_tan + f_rad = -t_z / (z_t + t_z) (p_t - e),  e = p0 + f o \
         t_tan / t_z",
    derivation: "p_s - p0 = [z d + f o t] / (z + t_z); subtract d. Not the sum of the flows of the parts: the tangential flow \
                 is seen from the source depth, so it comes with the factor z_t / (z_t + t_z). At the focus e the bracket \
                 vanishes; for t_z = 0 there is no focus.",
    counter_example: None,
    correction: None,
    functions: &[
        "flow::translational::translational_flow",
        "flow::translational::flow_from_parts",
        "flow::translational::flow_about_focus",
        "flow::translational::focus_of_expansion",
        "flow::rigid::rigid_flow_by_parts",
        "flow::gradients::rigid_gradients",
    ],
    taped: &["taped::rigid_flow", "taped::so3_exp"],
    missing_way: None,
    check,
};

const NOWHERE: Vector2<f64> = Vector2::new(f64::NAN, f64::NAN);

fn check(trial: &mut Trial) {
    trial.cases(at);
    let (camera, t, p, z) = (scenes::kitti640(), Vector3::new(0.3, -0.1, 0.6), Vector2::new(451.0, 63.0), 12.5);
    let flow = translational_flow(&camera, &t, &p, z).unwrap_or(NOWHERE);
    let sum = tangential_flow(&camera, &t, z) + radial_flow(&camera, t.z, &p, z).unwrap_or(NOWHERE);
    let focus = focus_of_expansion(&camera, &t).unwrap_or(NOWHERE);
    let motion = Se3::from_rotation_vector(&Vector3::new(0.03, -0.05, 0.02), t);
    let turned = rigid_flow_by_parts(&camera, &motion, &p, z).map_or(NOWHERE, |(rotational, rest)| rotational + rest);
    let expected =
        [[2.50076335878, 0.408036641221, 505.6, -16.0849042832], [-1.30259541985, -0.135074198473, 34.56, -9.07775325806]];
    for (k, [whole, extra, centre, with_rotation]) in expected.into_iter().enumerate() {
        trial.findings.documented("flow, documented", flow[k], whole, 1e-11);
        trial.findings.documented("f_tan + f_rad - f, documented", sum[k] - flow[k], extra, 1e-11);
        trial.findings.documented("focus, documented", focus[k], centre, 1e-11);
        trial.findings.documented("flow with rotation, documented", turned[k], with_rotation, 1e-11);
    }
    trial.findings.gap("sum of the flows of the parts - flow, px", (sum - flow).norm(), 0.387);
    trial.findings.gap("with a rotation: equation for R = I - flow, px", (flow - turned).norm(), 18.0);
}

fn at(case: &Case, f: &mut Findings) {
    with_rotation(case, f);
    let (camera, t, p, z) = (&case.camera, case.motion.translation, case.pixel, case.depth);
    let flow = translational_flow(camera, &t, &p, z).unwrap_or(NOWHERE);
    let (other, _) = forward::rigid_flow::<f64>(camera, [0.0; 3], t.into(), p.into(), z);
    f.residual("R = I: flow - full projection, px", (flow - Vector2::from(other)).norm(), 1e-10);
    let parts = flow_from_parts(camera, &t, &p, z).unwrap_or(NOWHERE);
    f.residual("z_t / z_s f_tan + f_rad - flow, px", (parts - flow).norm(), 1e-10);
    let sum = tangential_flow(camera, &t, z) + radial_flow(camera, t.z, &p, z).unwrap_or(NOWHERE);
    let extra = tangential_flow(camera, &t, z) * (t.z / (z + t.z));
    f.residual("f_tan + f_rad exceeds the flow by t_z / z_s f_tan, px", (sum - flow - extra).norm(), 1e-10);
    match flow_about_focus(camera, &t, &p, z) {
        Some(about) => f.residual("flow about the focus - flow, px", (about - flow).norm(), 1e-10),
        None => f.residual("no focus only for t_z = 0", t.z, 0.0),
    }
    slopes(case, f);
}

/// Derivatives by `t` and `z` without rotation.
fn slopes(case: &Case, f: &mut Findings) {
    let (camera, t, p, z) = (&case.camera, case.motion.translation, case.pixel, case.depth);
    let Some(g) = translational_gradients(camera, &t, &p, z) else {
        return f.residual("point in front of the camera", f64::NAN, 1.0);
    };
    let closed: Vec<f64> = (0..2).flat_map(|row| [g.t_x[row], g.t_y[row], g.t_z[row], g.z[row]]).collect();
    let x = [t.x, t.y, t.z, z];
    let dual = forward::jacobian(x, |[t_x, t_y, t_z, z]| {
        forward::rigid_flow(camera, forward::fixed([0.0; 3]), [t_x, t_y, t_z], forward::fixed(p.into()), z).0
    });
    let central = forward::central(x, [1e-6 * z; 4], |[t_x, t_y, t_z, z]| {
        forward::rigid_flow::<f64>(camera, [0.0; 3], [t_x, t_y, t_z], p.into(), z).0
    });
    let (_, rows) = taped::rigid_flow(camera, &Vector3::zeros(), &t, &p, z);
    let tape: Vec<f64> = rows[..2].iter().flat_map(|row| row[3..].to_vec()).collect();
    // A translation of the size of the source depth moves pixels by f and by their offset.
    let scale = (camera.fu.max(camera.fv) + case.offset().norm()) / (z + t.z);
    f.derivative("R = I: df/d(t, z)", &closed, Some(&dual), Some(&tape), Some(&central), scale);
}

/// With a rotation: the flow by its parts, and its derivative by depth.
fn with_rotation(case: &Case, f: &mut Findings) {
    let (camera, motion, p, z) = (&case.camera, &case.motion, case.pixel, case.depth);
    let (omega, t) = (so3::log(&motion.rotation), motion.translation);
    let (other, source_depth) = forward::rigid_flow::<f64>(camera, omega.into(), t.into(), p.into(), z);
    let parts = rigid_flow_by_parts(camera, motion, &p, z).map_or(NOWHERE, |(rotational, rest)| rotational + rest);
    f.residual("rotational flow + flow at the turned pixel - full projection, px", (parts - Vector2::from(other)).norm(), 1e-10);
    let closed = rigid_gradients(camera, motion, &p, z).map_or(NOWHERE, |g| g.z);
    let dual = forward::jacobian([z], |[z]| {
        forward::rigid_flow(camera, forward::fixed(omega.into()), forward::fixed(t.into()), forward::fixed(p.into()), z).0
    });
    let central =
        forward::central([z], [1e-6 * z], |[z]| forward::rigid_flow::<f64>(camera, omega.into(), t.into(), p.into(), z).0);
    let (_, rows) = taped::rigid_flow(camera, &omega, &t, &p, z);
    let turned = transfer(&rotation_homography(camera, &motion.rotation), &p).map_or(NOWHERE, |(pixel, _)| pixel);
    let offset = (turned - camera.principal_point()).norm();
    let scale = (camera.fu.max(camera.fv) + offset) / source_depth;
    f.derivative(
        "with a rotation: df/dz",
        closed.as_slice(),
        Some(&dual),
        Some(&[rows[0][6], rows[1][6]]),
        Some(&central),
        scale,
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
    fn nothing_moves_at_the_focus() {
        let (camera, t) = (scenes::kitti640(), Vector3::new(0.3, -0.1, 0.6));
        let focus = focus_of_expansion(&camera, &t).unwrap();
        assert!(translational_flow(&camera, &t, &focus, 4.0).unwrap().norm() < 1e-12);
        assert!(flow_about_focus(&camera, &Vector3::x(), &focus, 4.0).is_none());
    }
}
