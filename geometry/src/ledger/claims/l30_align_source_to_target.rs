//! L30: the motion read from source to target (correction E).

use dimode_autodiff::Tape;
use nalgebra::{Matrix3, Vector2};

use super::l24_residual_rows::estimate;
use crate::alignment::corrections::source_to_target;
use crate::alignment::{Aligned, Convention, Match, axial, planar};
use crate::deviation::residual_rows;
use crate::flow::rigid::rigid_flow;
use crate::ledger::{Case, Claim, Findings, Trial, Verdict};
use crate::motion::{MotionParts, radial_part, tangential_part};
use crate::ratios::{inverse_radial_ratio, inverse_tangential_ratios};
use crate::se3::Se3;
use crate::taped::Pose;
use crate::taped::pose::pose_tensors;

pub(super) static CLAIM: Claim = Claim {
    id: "L30",
    slug: "align-source-to-target",
    place: "correction E of eq. pplanar",
    statement: "With P_t = A P_s + a the alignment is Q_pla = A P_s + rad(a), Q_axi = A P_s + tan(a), and eqs. transformation \
         and residual_rot hold as printed.",
    verdict: Verdict::Exact,
    condition: Some(
        "eq. p_s takes the inverse (A^T, -A^T a), the flows of the single motions take t = -a, and the ratios change sign",
    ),
    formula: "A = R^T, a = -t';  rho_x = z / a_x = -f_u / f_x,  rho_z = z / a_z = +d . (f + d) / (d . f)",
    derivation: "A P_s = P_t - a, so adding rad(a) leaves P_t - tan(a), adding tan(a) leaves P_t - rad(a). With a = -t' these \
         are the points of correction B. Pose networks that output the motion from source to target deliver A and a directly.",
    counter_example: None,
    correction: None,
    functions: &["alignment::corrections::source_to_target", "se3::Se3::inverse", "deviation::residual_rows"],
    taped: &["taped::pose::inverse"],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    let mut furthest = 0.0f64;
    for reference in crate::scenes::references() {
        let (camera, motion) = (&reference.scene.camera, &reference.motion);
        for m in reference.scene.matches(motion) {
            let both = source_to_target(camera, &motion.inverse(), &m);
            let b = planar(camera, &motion.rotation, &Convention::Consistent.translation(motion), &m);
            let gap = both.zip(b).map_or(f64::NAN, |(e, b)| (e.planar.flow - b.flow).norm());
            furthest = if gap.is_nan() { gap } else { furthest.max(gap) };
        }
        trial.count(reference.scene.pixels.len());
    }
    trial.findings.residual("E - B over the six reference motions, px", furthest, 1e-10);
}

fn at(case: &Case, f: &mut Findings) {
    let (camera, motion, back) = (&case.camera, &case.motion, case.motion.inverse());
    let Some(exact) = case.exact_match() else {
        return f.residual("point in front of the camera", f64::NAN, 1.0);
    };
    let a = Convention::Consistent.translation(motion);
    let b = planar(camera, &motion.rotation, &a, &exact).zip(axial(camera, &motion.rotation, &a, &exact));
    let (Some(e), Some((plane, axis))) = (source_to_target(camera, &back, &exact), b) else {
        return f.residual("aligned points in front of the camera", f64::NAN, 1.0);
    };
    f.residual("planar flow, E - B, px", (e.planar.flow - plane.flow).norm(), 1e-10);
    f.residual("axial flow, E - B, px", (e.axial.flow - axis.flow).norm(), 1e-10);
    f.residual(
        "depths, E - B, relative",
        ((e.planar.depth - plane.depth).abs() + (e.axial.depth - axis.depth).abs()) / case.depth,
        1e-12,
    );
    inverses(case, &back, f);
    as_printed(case, &back, &exact, f);
    let recovered = inverse_tangential_ratios(camera, &e.planar.flow) * case.depth;
    let size = case.depth * 0.01 + back.translation.norm();
    f.residual("z f_pla / f + tan(a), relative", (recovered + back.translation.xy()).norm() / size, 1e-10);
    let d = case.offset();
    // Near the principal point the radial flow drowns in rounding.
    if d.norm() > 1.0 {
        let radial = inverse_radial_ratio(&e.axial.flow, &d) * case.depth;
        f.residual("z (d . f) / (d . (f + d)) - a_z, relative", (radial + back.translation.z) / size, 1e-9);
    }
}

/// Eqs. `transformation` and `residual_rot` with `(A, a)` for `T`: what estimates leave beside the part that was meant to stay.
fn as_printed(case: &Case, back: &Se3, exact: &Match, f: &mut Findings) {
    let parts = MotionParts::in_source_frame(back);
    let product = parts.radial * parts.tangential * parts.rotation;
    let gap = (product.rotation - back.rotation).amax() + (product.translation - back.translation).norm();
    f.residual("eq. transformation: T_rad T_tan T_rot - (A, a), by 1 + |a|", gap / (1.0 + back.translation.norm()), 1e-13);
    let guess = estimate(&Case { motion: *back, ..*case });
    // Estimates can bring an aligned point behind the camera, where it has no pixel.
    let Some(e) = source_to_target(&case.camera, &guess, exact) else {
        return;
    };
    let (rows, target) = (residual_rows(back, &guess), case.point());
    let seen = |aligned: &Aligned| {
        let p = case.pixel + aligned.flow;
        case.camera.ray(p.x, p.y) * aligned.depth
    };
    let scale = 1.0 + target.norm();
    let planar = rows.tangential.transform(&seen(&e.planar)) + tangential_part(&back.translation) - target;
    let axial = rows.radial.transform(&seen(&e.axial)) + radial_part(&back.translation) - target;
    f.residual("eq. residual_rot: T_tan dT_tan Q_pla of estimates - P_t, relative", planar.norm() / scale, 1e-12);
    f.residual("eq. residual_rot: T_rad dT_rad Q_axi of estimates - P_t, relative", axial.norm() / scale, 1e-12);
}

fn inverses(case: &Case, back: &Se3, f: &mut Findings) {
    let (motion, twice) = (&case.motion, back.inverse());
    let scale = 1.0 + motion.translation.norm();
    let gap = (twice.rotation - motion.rotation).amax() + (twice.translation - motion.translation).norm();
    f.residual("inverse of the inverse - T", gap / scale, 1e-13);
    let product = *motion * *back;
    f.residual("T T^-1 - I", ((product.rotation - Matrix3::identity()).amax() + product.translation.norm()) / scale, 1e-13);
    f.residual("a + t', by 1 + |t|", (back.translation + case.in_target()).norm() / scale, 1e-13);
    let tape = Tape::<f64>::new();
    let (r, t) = pose_tensors(&[*motion]);
    let taped = Pose { rotation: tape.constant(r), translation: tape.constant(t) }.inverse().to_se3()[0];
    let gap = (taped.rotation - back.rotation).amax() + (taped.translation - back.translation).norm();
    f.residual("taped inverse - inverse", gap / scale, 1e-13);
    let rigid = rigid_flow(&case.camera, &twice, &case.pixel, case.depth).map_or(Vector2::repeat(f64::NAN), |x| x.0);
    let direct = rigid_flow(&case.camera, motion, &case.pixel, case.depth).map_or(Vector2::repeat(f64::NAN), |x| x.0);
    f.residual("eq. p_s with the inverse of (A, a) - with T, by 1 + |f|", (rigid - direct).norm() / (1.0 + direct.norm()), 1e-12);
}

#[cfg(test)]
mod tests {
    crate::ledger::testing::tests_on_cases!(super::at);
}
