//! L11: the flow of a rotation does not depend on depth.

use nalgebra::{Vector2, Vector3};

use crate::flow::gradients::rigid_gradients;
use crate::flow::rigid::rigid_flow;
use crate::ledger::{Case, Claim, Findings, Trial, Verdict, forward, taped};
use crate::{Se3, scenes, so3};

pub(super) static CLAIM: Claim = Claim {
    id: "L11",
    slug: "rot-depth-free",
    place: "introduction; section on the motion components",
    statement: "The flow of a rotation carries no information about depth.",
    verdict: Verdict::Exact,
    condition: Some("t = 0"),
    formula: "df/dz = 0",
    derivation: "f = pi(H p~) - p with H = K R K^-1, and H holds no depth. In df/dz = -(h_3 . p~) [f o t - (p_R - p0) t_z] / \
                 (z_R + t_z)^2 the bracket vanishes with t.",
    counter_example: None,
    correction: None,
    functions: &["flow::rotational::rotational_flow", "flow::gradients::rigid_gradients"],
    taped: &["taped::rigid_flow", "taped::so3_exp"],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    let motion = Se3::from_rotation_vector(&Vector3::new(0.03, -0.05, 0.02), Vector3::zeros());
    for depth in [5.0, 50.0] {
        let flow = rigid_flow(&scenes::kitti640(), &motion, &Vector2::new(451.0, 63.0), depth);
        let flow = flow.map_or(Vector2::repeat(f64::NAN), |(flow, _)| flow);
        trial.findings.documented("flow at 5 and at 50 m, documented", flow.x, -19.4329111175, 1e-11);
        trial.findings.documented("flow at 5 and at 50 m, documented", flow.y, -8.16065596442, 1e-11);
    }
}

fn at(case: &Case, f: &mut Findings) {
    let case = case.with_translation(Vector3::zeros());
    let (camera, motion, p, z) = (&case.camera, &case.motion, case.pixel, case.depth);
    let omega = so3::log(&motion.rotation);
    let flow = |z| rigid_flow(camera, motion, &p, z).map_or(Vector2::repeat(f64::NAN), |(flow, _)| flow);
    f.residual("flow at one depth - flow at another, px", (flow(z) - flow(case.extra(0, 0.5, 80.0))).norm(), 1e-10);
    let closed = rigid_gradients(camera, motion, &p, z).map_or(Vector2::repeat(f64::NAN), |g| g.z);
    f.residual("df/dz, px/m", closed.norm(), 1e-12);
    let dual = forward::jacobian([z], |[z]| {
        forward::rigid_flow(camera, forward::fixed(omega.into()), forward::fixed([0.0; 3]), forward::fixed(p.into()), z).0
    });
    let central =
        forward::central([z], [1e-6 * z], |[z]| forward::rigid_flow::<f64>(camera, omega.into(), [0.0; 3], p.into(), z).0);
    let (_, rows) = taped::rigid_flow(camera, &omega, &Vector3::zeros(), &p, z);
    // The flow of a translation changes with depth by up to f |t| / z^2, and |t| can be as large as z.
    let scale = camera.fu.max(camera.fv) / z;
    f.derivative("df/dz", closed.as_slice(), Some(&dual), Some(&[rows[0][6], rows[1][6]]), Some(&central), scale);
    // A translation of 1 % of the depth: now depth does count, and every way notices it.
    let moved = Se3 { translation: Vector3::new(0.01 * z, 0.0, 0.0), ..*motion };
    let gradient = rigid_gradients(camera, &moved, &p, z).map_or(f64::NAN, |g| g.z.norm());
    f.floor("with 1 % of translation: |df/dz| z / f_u", gradient * z / camera.fu, 0.001);
}

#[cfg(test)]
mod tests {
    crate::ledger::testing::tests_on_cases!(super::at);
}
