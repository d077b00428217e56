//! What the alignment leaves over when rotation and translation are estimates (eq. `residual_rot` and the remark below it).
//!
//! Motions are `source_from_target` with true parts `R, t` and estimated ones `R_hat, t_hat`; a leftover is the motion between
//! the aligned frames beside the part that was meant to stay.

use nalgebra::{Matrix3, Vector3};

use crate::motion::{MotionParts, radial_part, remaining_radial, remaining_tangential, tangential_part};
use crate::se3::Se3;

/// The two rows of eq. `residual_rot`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResidualRows {
    /// After rotation and tangential translation were undone: what is left beside `T_rad`.
    pub radial: Se3,
    /// After rotation and radial translation were undone: what is left beside `T_tan`.
    pub tangential: Se3,
}

/// `dR = R_hat R^-1`: the rotation that carries the true orientation to the estimated one.
#[must_use]
pub fn rotation_deviation(truth: &Se3, estimate: &Se3) -> Matrix3<f64> {
    estimate.rotation * truth.rotation.transpose()
}

/// Eq. `residual_rot`, in closed form: with `dt = t_hat - t`,
/// `[dR^-1, (I - dR^-1) t_tan - dR^-1 dt_tan]` beside `T_rad` and `[dR^-1, (I - dR^-1) t_rad - dR^-1 dt_rad]` beside `T_tan`.
///
/// **Reading**: the estimate is undone on the right of `T`, which with `T` from source to target means "turn the source points
/// by the estimated rotation, then add the estimated part". With the alignment of eq. `pplanar` see [`alignment_residual`].
#[must_use]
pub fn residual_rows(truth: &Se3, estimate: &Se3) -> ResidualRows {
    let inverse = rotation_deviation(truth, estimate).transpose();
    let error = estimate.translation - truth.translation;
    let row = |part: fn(&Vector3<f64>) -> Vector3<f64>| {
        let t = part(&truth.translation);
        Se3 { rotation: inverse, translation: t - inverse * t - inverse * part(&error) }
    };
    ResidualRows { radial: row(tangential_part), tangential: row(radial_part) }
}

/// Eq. `residual_rot` as the product of motions that it stands for: `T_rad^-1 T T_hat_rot^-1 T_hat_tan^-1` and
/// `T_tan^-1 T T_hat_rot^-1 T_hat_rad^-1`.
#[must_use]
pub fn residual_products(truth: &Se3, estimate: &Se3) -> ResidualRows {
    let (parts, guess) = (MotionParts::in_source_frame(truth), MotionParts::in_source_frame(estimate));
    ResidualRows {
        radial: parts.radial.inverse() * remaining_radial(truth, &guess),
        tangential: parts.tangential.inverse() * remaining_tangential(truth, &guess),
    }
}

/// Source points turned by the estimated rotation and moved by the estimated tangential part, or by the radial part:
/// `P_s' = R_hat P_s + tan(t_hat)` and `R_hat P_s + rad(t_hat)`, with `T` read from source to target.
///
/// What is left to the target point is `P_t = T_rad dT_rad P_s'` with the first of [`residual_rows`], and likewise for the other.
#[must_use]
pub fn partly_moved_points(estimate: &Se3, source_point: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let turned = estimate.rotation * source_point;
    [turned + tangential_part(&estimate.translation), turned + radial_part(&estimate.translation)]
}

/// Deviation left by the alignment when pose and translation are estimates, target-frame convention.
///
/// `E = R_hat^T R`; the planar alignment leaves `[E, (E - I) t' - rad(t'_hat - t')]`, the axial one
/// the same with the tangential part. Returns `(planar, axial)`.
/// **Reading**: replaces eq. `residual_rot`; the whole translation enters, not only the other part.
#[must_use]
pub fn alignment_residual(truth: &Se3, estimate: &Se3) -> (Se3, Se3) {
    let rotation = estimate.rotation.tr_mul(&truth.rotation);
    let t = truth.translation_in_from_frame();
    let error = estimate.translation_in_from_frame() - t;
    let turned = rotation * t - t;
    let with = |part: Vector3<f64>| Se3 { rotation, translation: turned - part };
    (with(radial_part(&error)), with(tangential_part(&error)))
}

/// What [`alignment_residual`] stands for, from the motion of the aligned points: `(planar, axial)`.
///
/// The aligned point is `R_hat^T (R P + t) - part(t'_hat)`; the part of `t'` that was meant to stay is taken off in front.
#[must_use]
pub fn alignment_products(truth: &Se3, estimate: &Se3) -> (Se3, Se3) {
    let (parts, guess) = (MotionParts::in_target_frame(truth), MotionParts::in_target_frame(estimate));
    let unrotated = guess.rotation.inverse() * *truth;
    let planar = parts.tangential.inverse() * guess.radial.inverse() * unrotated;
    let axial = parts.radial.inverse() * guess.tangential.inverse() * unrotated;
    (planar, axial)
}

/// What estimates leave when `P_s - part(t_hat)` is compared with the target turned by `R_hat` (correction C of the alignment):
/// `[dR^-1, -dt_tan]` beside `T_rad` and `[dR^-1, -dt_rad]` beside `T_tan`, without the cross term of eq. `residual_rot`.
#[must_use]
pub fn rotated_target_residual(truth: &Se3, estimate: &Se3) -> ResidualRows {
    let rotation = rotation_deviation(truth, estimate).transpose();
    let error = estimate.translation - truth.translation;
    ResidualRows {
        radial: Se3 { rotation, translation: -tangential_part(&error) },
        tangential: Se3 { rotation, translation: -radial_part(&error) },
    }
}

/// Translation that a rotation deviation adds to the other part, from eq. `residual_rot`: `(I - dR^-1) v`.
#[must_use]
pub fn induced_translation(deviation: &Matrix3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
    v - deviation.tr_mul(v)
}

/// The same as the text below eq. `residual_rot` prints it, `(I - dR) v`: as long as [`induced_translation`], to first order
/// its negative. For comparison only.
#[must_use]
pub fn printed_induced_translation(deviation: &Matrix3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
    v - deviation * v
}

/// [`induced_translation`] to first order in the rotation vector of the deviation: `eps x v`.
///
/// For `v = (0, 0, t_z)` that is `t_z (eps_y, -eps_x, 0)`: purely tangential, and roll adds nothing.
#[must_use]
pub fn induced_translation_first_order(eps: &Vector3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
    eps.cross(v)
}

/// Flow at the principal point, pixels, of a small rotation `angle` (radians) about a transverse axis: `f angle`.
#[must_use]
pub fn rotation_flow_size(focal: f64, angle: f64) -> f64 {
    focal * angle
}

/// Flow, pixels, of the translation that the same rotation induces through a radial translation: `f angle t_z / z`.
#[must_use]
pub fn induced_flow_size(focal: f64, angle: f64, t_z: f64, z: f64) -> f64 {
    rotation_flow_size(focal, angle) * t_z / z
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;

    fn gap(a: &Se3, b: &Se3) -> f64 {
        (a.rotation - b.rotation).abs().max() + (a.translation - b.translation).norm()
    }

    fn poses() -> (Se3, Se3) {
        let pose = |w: [f64; 3], t: [f64; 3]| Se3::from_rotation_vector(&w.into(), t.into());
        (pose([0.03, -0.05, 0.02], [0.06, 0.04, -0.08]), pose([0.032, -0.047, 0.021], [0.066, 0.037, -0.085]))
    }

    #[test]
    fn residuals_match_reference_values() {
        let (truth, estimate) = poses();
        let (planar, _) = alignment_residual(&truth, &estimate);
        let expected = Vector3::new(0.000284298533312, -0.000223880002433, 0.00517431067159);
        assert!((planar.translation - expected).norm() < 1e-12, "{}", planar.translation);
        let rows = residual_rows(&truth, &estimate);
        let expected = Vector3::new(-0.00604025359731, 0.00307211200459, -0.000126463439953);
        assert!((rows.radial.translation - expected).norm() < 1e-12, "{}", rows.radial.translation);
    }

    #[test]
    fn perfect_estimates_leave_nothing() {
        let truth = testing::handheld();
        let (planar, axial) = alignment_residual(&truth, &truth);
        let rows = residual_rows(&truth, &truth);
        for leftover in [planar, axial, rows.radial, rows.tangential] {
            assert!(gap(&leftover, &Se3::identity()) < 1e-15);
        }
    }

    #[test]
    fn roll_induces_no_translation_and_yaw_a_sideways_one() {
        let v = Vector3::new(0.0, 0.0, -1.0);
        let turned = |eps: Vector3<f64>| induced_translation(&crate::so3::exp(&eps), &v);
        assert!(turned(Vector3::new(0.0, 0.0, 0.1)).norm() < 1e-15);
        assert!(turned(Vector3::new(0.0, 1e-3, 0.0)).x < -9e-4);
        assert!((induced_flow_size(371.2, 0.1f64.to_radians(), 1.0, 10.0) - 0.064786621834).abs() < 1e-11);
    }
}
