//! L15: flow of a radial translation.

use nalgebra::{Vector2, Vector3};

use crate::flow::gradients::translational_gradients;
use crate::flow::radial::radial_flow;
use crate::ledger::{Case, Claim, Findings, Trial, Verdict, forward, taped};
use crate::scenes;

pub(super) static CLAIM: Claim = Claim {
    id: "L15",
    slug: "rad-flow",
    place: "eqs. radial_correspondence, radial_correspondence_2, radial_flow",
    statement: "A radial translation t_z draws the flow -t_z / (z_t + t_z) (p_t - p0): radial about the principal point.",
    verdict: Verdict::Exact,
    condition: Some("R = I, t_x = t_y = 0, z_t + t_z > 0"),
    formula: "f = -t_z / (z_t + t_z) d,  d = p_t - p0",
    derivation: "p_s - p0 = d z_t / (z_t + t_z); subtract d. Toward p0 for t_z > 0, away for t_z < 0, zero at p0.",
    counter_example: None,
    correction: None,
    functions: &["flow::radial::radial_flow", "flow::gradients::translational_gradients"],
    taped: &["taped::rigid_flow", "taped::so3_exp"],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    let (camera, p) = (scenes::kitti640(), Vector2::new(451.0, 63.0));
    for (t_z, expected) in [(0.6, [-6.0, 1.51145038168]), (-0.8, [8.95726495726, -2.25641025641])] {
        let flow = radial_flow(&camera, t_z, &p, 12.5).unwrap_or(Vector2::repeat(f64::NAN));
        for k in 0..2 {
            trial.findings.documented("flow at (451, 63), documented", flow[k], expected[k], 1e-11);
        }
    }
}

fn at(case: &Case, f: &mut Findings) {
    let (t_z, z, d) = (case.motion.translation.z, case.depth, case.offset());
    let flow = radial_flow(&case.camera, t_z, &case.pixel, z).unwrap_or(Vector2::repeat(f64::NAN));
    let projected = case.camera.project(&(case.point() + Vector3::new(0.0, 0.0, t_z))).unwrap_or(Vector2::repeat(f64::NAN));
    f.residual("flow - full projection, px", (flow - (projected - case.pixel)).norm(), 1e-10);
    let size = d.norm() * flow.norm();
    f.equal("f x d, relative to |f| |d|", flow.perp(&d), 0.0, size, 1e-10);
    f.equal("f . d + sign(t_z) |f| |d|, relative", flow.dot(&d), -t_z.signum() * size, size, 1e-10);
    let (other, _) = forward::rigid_flow::<f64>(&case.camera, [0.0; 3], [0.0, 0.0, t_z], case.pixel.into(), z);
    f.residual("flow - flow written out, px", (flow - Vector2::from(other)).norm(), 1e-10);
    slopes(case, &flow, f);
}

/// The flow on the tape, and its derivatives by `t_z` and `z`.
fn slopes(case: &Case, flow: &Vector2<f64>, f: &mut Findings) {
    let (camera, p, z) = (&case.camera, case.pixel, case.depth);
    let t = Vector3::new(0.0, 0.0, case.motion.translation.z);
    let Some(g) = translational_gradients(camera, &t, &p, z) else {
        return f.residual("point in front of the camera", f64::NAN, 1.0);
    };
    let closed: Vec<f64> = (0..2).flat_map(|row| [g.t_z[row], g.z[row]]).collect();
    let x = [t.z, z];
    let dual = forward::jacobian(x, |[t_z, z]| {
        let [zero] = forward::fixed([0.0]);
        forward::rigid_flow(camera, [zero; 3], [zero, zero, t_z], forward::fixed(p.into()), z).0
    });
    let central = forward::central(x, [1e-6 * z; 2], |[t_z, z]| {
        forward::rigid_flow::<f64>(camera, [0.0; 3], [0.0, 0.0, t_z], p.into(), z).0
    });
    let (values, rows) = taped::rigid_flow(camera, &Vector3::zeros(), &t, &p, z);
    f.residual("flow - flow on the tape, px", (flow - Vector2::new(values[0], values[1])).norm(), 1e-10);
    let tape: Vec<f64> = rows[..2].iter().flat_map(|row| [row[5], row[6]]).collect();
    // How far a unit of translation moves a pixel: the offset from p0, which this flow is proportional to, may be zero.
    let scale = camera.fu.max(camera.fv) / (z + t.z);
    f.derivative("df/d(t_z, z)", &closed, Some(&dual), Some(&tape), Some(&central), scale);
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
    fn there_is_no_flow_at_the_principal_point() {
        let camera = scenes::kitti640();
        assert_eq!(radial_flow(&camera, 0.6, &camera.principal_point(), 12.5), Some(Vector2::zeros()));
    }
}
