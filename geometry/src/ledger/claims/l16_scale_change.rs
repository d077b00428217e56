//! L16: change of image scale and depth.

use nalgebra::{Vector2, Vector3};

use crate::camera::Intrinsics;
use crate::flow::radial::{scale_change, scale_change_first_order, scale_change_slope};
use crate::ledger::{Case, Claim, Findings, Trial, Verdict, forward, taped};

pub(super) static CLAIM: Claim = Claim {
    id: "L16",
    slug: "scale-change",
    place: "introduction",
    statement: "The change of image scale is inversely proportional to depth.",
    verdict: Verdict::FirstOrder,
    condition: Some("to the source depth exactly; to the target depth only for |t_z| << z_t"),
    formula: "s = z_t / (z_t + t_z),  s - 1 = -t_z / z_s = -t_z / z_t + t_z^2 / [z_t (z_t + t_z)]",
    derivation: "Two points of one depth are seen at a distance proportional to 1 / z, so their distance changes by z_t / z_s. \
                 Subtract 1: (z_t - z_s) / z_s = -t_z / z_s.",
    counter_example: Some("z = 5, t_z = -0.8: the scale changes by 0.190476, -t_z / z_t is 0.16, 16 % too low."),
    correction: Some("Inversely proportional to the source depth z_t + t_z."),
    functions: &["flow::radial::scale_change", "flow::radial::scale_change_first_order", "flow::radial::scale_change_slope"],
    taped: &["taped::rigid_flow", "taped::so3_exp"],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    let (exact, first) = (scale_change(5.0, -0.8) - 1.0, scale_change_first_order(5.0, -0.8) - 1.0);
    trial.findings.documented("s - 1 for z = 5, t_z = -0.8, documented", exact, 0.190476190476, 1e-11);
    trial.findings.documented("-t_z / z_t for z = 5, t_z = -0.8, documented", first, 0.16, 1e-11);
    trial.findings.gap("z = 5, t_z = -0.8: (first order - exact) / exact", first / exact - 1.0, 0.144);
}

fn at(case: &Case, f: &mut Findings) {
    let (t_z, z) = (case.motion.translation.z, case.depth);
    let (s, source_depth) = (scale_change(z, t_z), z + t_z);
    f.residual("(s - 1) z_s + t_z, relative to z", ((s - 1.0) * source_depth + t_z) / z, 1e-13);
    let error = s - scale_change_first_order(z, t_z);
    f.residual("s - first order - t_z^2 / (z_t z_s)", error - t_z * t_z / (z * source_depth), 1e-13);
    distances(case, s, f);
    slope(case, f);
}

/// The scale is what distances between pixels of one depth are multiplied by.
fn distances(case: &Case, s: f64, f: &mut Findings) {
    let (camera, t) = (&case.camera, [0.0, 0.0, case.motion.translation.z]);
    let moved = |p: Vector2<f64>| p + Vector2::from(forward::rigid_flow::<f64>(camera, [0.0; 3], t, p.into(), case.depth).0);
    let other = Vector2::new(case.extra(0, 0.0, 640.0), case.extra(1, 0.0, 192.0));
    let (before, after) = (other - case.pixel, moved(other) - moved(case.pixel));
    f.residual("image of a segment - s times the segment, px", (after - before * s).norm(), 1e-10);
}

/// Derivative by `t_z`. One pixel right of the principal point the flow is `s - 1` pixels.
fn slope(case: &Case, f: &mut Findings) {
    let (camera, t_z, z) = (&case.camera, case.motion.translation.z, case.depth);
    let p = camera.principal_point() + Vector2::x();
    let dual = forward::jacobian([t_z], |[t_z]| {
        let [zero, z] = forward::fixed([0.0, z]);
        [forward::rigid_flow(camera, [zero; 3], [zero, zero, t_z], forward::fixed(p.into()), z).0[0]]
    });
    // Around p0 = 0 no digits are lost to its size.
    let centred = Intrinsics { u0: 0.0, v0: 0.0, ..*camera };
    let central = forward::central([t_z], [1e-6 * z], |[t_z]| {
        [forward::rigid_flow::<f64>(&centred, [0.0; 3], [0.0, 0.0, t_z], [1.0, 0.0], z).0[0]]
    });
    let (values, rows) = taped::rigid_flow(camera, &Vector3::zeros(), &Vector3::new(0.0, 0.0, t_z), &p, z);
    f.residual("s - 1 - flow on the tape at 1 px, px", scale_change(z, t_z) - 1.0 - values[0], 1e-13);
    f.derivative("ds/dt_z", &[scale_change_slope(z, t_z)], Some(&dual), Some(&[rows[0][5]]), Some(&central), 1.0 / z);
    let at_zero = scale_change_first_order(z, 0.5 * z) - scale_change_first_order(z, -0.5 * z);
    f.equal("slope of the first order - ds/dt_z at t_z = 0, relative", at_zero / z, scale_change_slope(z, 0.0), 1.0 / z, 1e-14);
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
        fn the_first_order_is_always_too_low(case in case()) {
            let (t_z, z) = (case.motion.translation.z, case.depth);
            prop_assert!(scale_change_first_order(z, t_z) <= scale_change(z, t_z) + 1e-15);
        }
    }
}
