//! L25: the remark below eq. `residual_rot`.

use nalgebra::Vector3;

use crate::deviation::{
    induced_flow_size, induced_translation, induced_translation_first_order, printed_induced_translation, residual_rows,
    rotation_flow_size,
};
use crate::flow::{rotational::rotational_flow, tangential::tangential_flow};
use crate::ledger::{Case, Claim, Findings, Trial, Verdict};
use crate::motion::{radial_part, tangential_part};
use crate::se3::Se3;
use crate::{scenes, so3};

pub(super) static CLAIM: Claim = Claim {
    id: "L25",
    slug: "residual-remark",
    place: "last paragraph of the section on motion components",
    statement: "A rotation deviation dR adds (I - dR) t_rad to the tangential translation, which matters as radial motion \
         dominates.",
    verdict: Verdict::Fails,
    condition: None,
    formula: "added: (I - dR^-1) t_rad = eps x t_rad + O(eps^2) = t_z (eps_y, -eps_x, 0) + O(eps^2)",
    derivation: "The second row of eq. residual_rot with dt = 0 has (I - dR^-1) t_rad. As dR (I - dR^-1) = dR - I, the printed \
         vector is its image under -dR: equal length, to first order the opposite direction. Both are tangential to first \
         order; roll adds nothing. The rotation dR^-1 itself moves pixels by f eps, the translation it induces by f eps t_z / z \
         only.",
    counter_example: Some(
        "0.1 deg of yaw, t_rad = (0, 0, -1): printed x = 0.00174533, true x = -0.00174533, common length 0.00174532903. At t_z \
         = 1 the rotation moves pixels by 0.648 px, the induced translation by 0.0648 px at 10 m and 0.0162 px at 40 m. \
         Measured on KITTI odometry 00-10: |t_z| / |t_tan| has 10/50/90 % 16.1/43.5/83.3; 0.1 deg induces 0.00164 m (median), 7 \
         % of the median |t_tan| of 0.0228 m, and 1.4 deg would be needed to equal it.",
    ),
    correction: Some("(I - dR^-1) t_rad; the larger part of the deviation is the rotation dR^-1 itself, by the factor z / t_z."),
    functions: &[
        "deviation::induced_translation",
        "deviation::printed_induced_translation",
        "deviation::induced_translation_first_order",
        "deviation::rotation_flow_size",
        "deviation::induced_flow_size",
    ],
    taped: &[],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    let f = &mut trial.findings;
    let (angle, v) = (0.1f64.to_radians(), Vector3::new(0.0, 0.0, -1.0));
    let yaw = so3::exp(&Vector3::new(0.0, angle, 0.0));
    let (printed, derived) = (printed_induced_translation(&yaw, &v), induced_translation(&yaw, &v));
    f.documented("printed x, documented, m", printed.x, 0.0017453283659, 1e-10);
    f.documented("derived x, documented, m", derived.x, -0.0017453283659, 1e-10);
    f.gap("printed - derived, relative to their length", (printed - derived).norm() / derived.norm(), 1.9);
    for vector in [printed, derived] {
        f.documented("length, documented, m", vector.norm(), 0.00174532903047, 1e-10);
    }
    let fu = scenes::kitti640().fu;
    f.documented("flow of the rotation, documented, px", rotation_flow_size(fu, angle), 0.647866218340, 1e-11);
    for (z, expected) in [(10.0, 0.0647866218340), (40.0, 0.0161966554585)] {
        f.documented("flow of the induced translation, documented, px", induced_flow_size(fu, angle, 1.0, z), expected, 1e-10);
    }
    f.gap(
        "flow of the rotation over that of the induced translation at 40 m",
        rotation_flow_size(fu, angle) / induced_flow_size(fu, angle, 1.0, 40.0),
        36.0,
    );
}

fn at(case: &Case, f: &mut Findings) {
    let (angle, v) = (1e-4 * 1000f64.powf(case.extra[2]), radial_part(&case.motion.translation));
    let eps = case.extra_direction(0) * angle;
    let turn = so3::exp(&eps);
    let (printed, derived) = (printed_induced_translation(&turn, &v), induced_translation(&turn, &v));
    let size = v.norm().max(f64::MIN_POSITIVE);
    f.equal("printed length - derived length, relative to |t_rad|", printed.norm(), derived.norm(), size, 1e-14);
    f.residual("dR (I - dR^-1) t_rad + (I - dR) t_rad, relative to |t_rad|", (turn * derived + printed).norm() / size, 1e-14);
    // The bound is met with equality up to higher orders for a transverse axis, hence the small margin for rounding.
    let curved = (derived - induced_translation_first_order(&eps, &v)).norm() / (0.5 * angle * angle * size);
    f.bound("|(I - dR^-1) t_rad - eps x t_rad|, by angle^2 |t_rad| / 2", curved, 1.0 + 1e-6);
    let opposite = (printed + derived).norm() / (angle * angle * size);
    f.bound("|printed + derived|, by angle^2 |t_rad|", opposite, 1.0 + 1e-6);
    row(case, turn, f);
    sizes(case, angle.min(0.01), f);
}

/// The derived vector is what the second row of eq. `residual_rot` has for `dt = 0`.
fn row(case: &Case, turn: nalgebra::Matrix3<f64>, f: &mut Findings) {
    let t = case.motion.translation;
    let estimate = Se3 { rotation: turn * case.motion.rotation, translation: t };
    let rows = residual_rows(&case.motion, &estimate);
    let gap = (rows.tangential.translation - induced_translation(&turn, &radial_part(&t))).norm();
    f.residual("second row for dt = 0 - derived, m, by 1 + |t|", gap / (1.0 + t.norm()), 1e-13);
    let gap = (rows.radial.translation - induced_translation(&turn, &tangential_part(&t))).norm();
    f.residual("first row for dt = 0 - (I - dR^-1) t_tan, m, by 1 + |t|", gap / (1.0 + t.norm()), 1e-13);
}

/// Flows at the principal point against `f angle` and `f angle t_z / z`.
fn sizes(case: &Case, angle: f64, f: &mut Findings) {
    let (camera, t_z, z) = (&case.camera, case.motion.translation.z, case.depth);
    let yaw = so3::exp(&Vector3::new(0.0, angle, 0.0));
    let turned = rotational_flow(camera, &yaw, &camera.principal_point()).map_or(f64::NAN, |flow| flow.norm());
    let size = rotation_flow_size(camera.fu, angle);
    f.bound("|flow of a yaw at p0 - f angle|, by f angle^3", (turned - size).abs() / (size * angle * angle), 0.5);
    let induced = induced_translation(&yaw, &Vector3::new(0.0, 0.0, t_z));
    let moved = tangential_flow(camera, &induced, z).norm();
    let size = induced_flow_size(camera.fu, angle, t_z.abs(), z);
    // angle^2 / 6 of the size is left by the sine, beside rounding of 1 - cos and sin of a small angle.
    f.bound(
        "|flow of the induced translation - f angle t_z / z|, by the size",
        (moved - size).abs() / size.max(f64::MIN_POSITIVE),
        2e-5,
    );
}

#[cfg(test)]
mod tests {
    crate::ledger::testing::tests_on_cases!(super::at);
}
