//! L14: flow of a tangential translation.

use nalgebra::{Vector2, Vector3};

use crate::flow::gradients::translational_gradients;
use crate::flow::tangential::{focal_scaled, tangential_flow};
use crate::ledger::{Case, Claim, Findings, Trial, Verdict, forward, taped};
use crate::scenes;

pub(super) static CLAIM: Claim = Claim {
    id: "L14",
    slug: "tan-flow",
    place: "eqs. tangential_correspondence, tangential_correspondence_2, tangential_flow",
    statement: "A tangential translation draws the flow (f_u t_x, f_v t_y) / z_t: parallel everywhere, inverse in depth.",
    verdict: Verdict::Exact,
    condition: Some("R = I, t_z = 0"),
    formula: "f = (f o t) / z_t,  z_s = z_t",
    derivation: "K (P + t) = z p~ + (f_u t_x, f_v t_y, 0): the third row stays z, so division by it gives p + (f o t) / z. The \
                 direction is that of f o t, which is that of t only where f_u = f_v.",
    counter_example: None,
    correction: None,
    functions: &["flow::tangential::tangential_flow", "flow::tangential::focal_scaled"],
    taped: &["taped::rigid_flow", "taped::so3_exp"],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    let flow = tangential_flow(&scenes::kitti640(), &Vector3::new(0.3, -0.1, 0.0), 12.5);
    trial.findings.documented("flow at (451, 63), documented", flow.x, 8.9088, 1e-11);
    trial.findings.documented("flow at (451, 63), documented", flow.y, -2.94912, 1e-11);
    // With f_u = 2 f_v a translation along (1, 1) is not seen along (1, 1).
    let skewed = crate::Intrinsics { fu: 800.0, fv: 400.0, ..scenes::kitti640() };
    let seen = tangential_flow(&skewed, &Vector3::new(0.1, 0.1, 0.0), 5.0).normalize();
    let turn = seen.perp(&Vector2::new(1.0, 1.0).normalize()).abs().asin();
    trial.findings.gap("f_u = 2 f_v: angle between flow and t, rad", turn, 0.29);
}

fn at(case: &Case, f: &mut Findings) {
    let t = case.motion.translation;
    let case = case.without_rotation().with_translation(Vector3::new(t.x, t.y, 0.0));
    let (camera, t, p, z) = (&case.camera, case.motion.translation, case.pixel, case.depth);
    let flow = tangential_flow(camera, &t, z);
    let (other, depth) = forward::rigid_flow::<f64>(camera, [0.0; 3], t.into(), p.into(), z);
    f.residual("flow - full projection, px", (flow - Vector2::from(other)).norm(), 1e-10);
    f.equal("z_s - z_t, relative", depth, z, z, 1e-15);
    let far = case.extra(0, 0.5, 80.0);
    let at_far = tangential_flow(camera, &t, far);
    f.equal("z |f| at two depths, relative", z * flow.norm(), far * at_far.norm(), z * flow.norm(), 1e-10);
    f.equal("flows at two depths, cross product, relative", flow.perp(&at_far), 0.0, flow.norm() * at_far.norm(), 1e-10);
    f.equal(
        "flows at two depths, same side, relative",
        flow.dot(&at_far),
        flow.norm() * at_far.norm(),
        flow.norm() * at_far.norm(),
        1e-10,
    );
    f.equal("flow along f o t, relative", flow.perp(&focal_scaled(camera, &t)), 0.0, flow.norm() * t.norm() * camera.fu, 1e-10);
    let elsewhere = Vector2::new(case.extra(1, 0.0, 640.0), case.extra(2, 0.0, 192.0));
    let (there, _) = forward::rigid_flow::<f64>(camera, [0.0; 3], t.into(), elsewhere.into(), z);
    f.residual("flow at another pixel of the same depth, px", (flow - Vector2::from(there)).norm(), 1e-10);
    slopes(&case, f);
}

/// Derivatives by `t_x`, `t_y` and `z`.
fn slopes(case: &Case, f: &mut Findings) {
    let (camera, t, p, z) = (&case.camera, case.motion.translation, case.pixel, case.depth);
    let Some(g) = translational_gradients(camera, &t, &p, z) else {
        return f.residual("point in front of the camera", f64::NAN, 1.0);
    };
    let inverse = g.z + tangential_flow(camera, &t, z) / z;
    let scale = camera.fu.max(camera.fv) / z;
    f.residual("df/dz + f / z, relative to f / z at |t| = z", inverse.norm() / scale, 1e-14);
    let closed: Vec<f64> = (0..2).flat_map(|row| [g.t_x[row], g.t_y[row], g.z[row]]).collect();
    let x = [t.x, t.y, z];
    let dual = forward::jacobian(x, |[t_x, t_y, z]| {
        let [t_z] = forward::fixed([0.0]);
        forward::rigid_flow(camera, forward::fixed([0.0; 3]), [t_x, t_y, t_z], forward::fixed(p.into()), z).0
    });
    let central = forward::central(x, [1e-6 * z; 3], |[t_x, t_y, z]| {
        forward::rigid_flow::<f64>(camera, [0.0; 3], [t_x, t_y, 0.0], p.into(), z).0
    });
    let (_, rows) = taped::rigid_flow(camera, &Vector3::zeros(), &t, &p, z);
    let tape: Vec<f64> = rows[..2].iter().flat_map(|row| [row[3], row[4], row[6]]).collect();
    f.derivative("df/d(t_x, t_y, z)", &closed, Some(&dual), Some(&tape), Some(&central), scale);
}

#[cfg(test)]
mod tests {
    crate::ledger::testing::tests_on_cases!(super::at);
}
