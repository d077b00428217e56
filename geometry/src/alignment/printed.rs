//! What the alignment of eq. `pplanar`, taken as printed, leaves of perfect inputs.
//!
//! `R^-1 P_s = P_t + R^T t`, so that after subtracting a part of `t` the defect `delta = (R^T - I) t` stays in both alignments.
//! Everything below is for exact depth, motion and flow; `a = t`, [`Convention::AsPrinted`](super::Convention::AsPrinted). It
//! vanishes with the rotation, and for a rotation about `t`.

use nalgebra::{Vector2, Vector3};

use crate::camera::Intrinsics;
use crate::flow::tangential::focal_scaled;
use crate::flow::translational::translational_flow;
use crate::loss_forms::ratio_terms::pixel_term;
use crate::loss_forms::{axial, mean, planar};
use crate::motion::{radial_part, tangential_part};
use crate::ratios::{radial_ratio, tangential_ratios};
use crate::se3::Se3;

/// `delta = t' - t = (R^T - I) t`, in the unit of `t`: what the printed alignment fails to remove.
#[must_use]
pub fn defect(source_from_target: &Se3) -> Vector3<f64> {
    source_from_target.translation_in_from_frame() - source_from_target.translation
}

/// [`defect`] to first order in the rotation vector: `-(omega x t)`.
#[must_use]
pub fn defect_first_order(omega: &Vector3<f64>, t: &Vector3<f64>) -> Vector3<f64> {
    t.cross(omega)
}

/// Planar flow of the printed alignment, pixels: `[f o (t_tan + delta_tan) - d delta_z] / (z + delta_z)`.
///
/// `None` unless `z + delta_z > 0`.
#[must_use]
pub fn planar_flow(camera: &Intrinsics, source_from_target: &Se3, p: &Vector2<f64>, z: f64) -> Option<Vector2<f64>> {
    let left = tangential_part(&source_from_target.translation) + defect(source_from_target);
    translational_flow(camera, &left, p, z)
}

/// Axial flow of the printed alignment, pixels: `[f o delta_tan - d (t_z + delta_z)] / (z + t_z + delta_z)`.
///
/// `None` unless `z + t_z + delta_z > 0`.
#[must_use]
pub fn axial_flow(camera: &Intrinsics, source_from_target: &Se3, p: &Vector2<f64>, z: f64) -> Option<Vector2<f64>> {
    let left = radial_part(&source_from_target.translation) + defect(source_from_target);
    translational_flow(camera, &left, p, z)
}

/// `e - p0 = f o delta_tan / (t_z + delta_z)`, pixels: where the printed axial flow's focus lies beside the principal point.
///
/// Depends on the rotation and the direction of `t` only. `None` for `t'_z = 0`.
#[must_use]
pub fn focus_offset(camera: &Intrinsics, source_from_target: &Se3) -> Option<Vector2<f64>> {
    let radial = source_from_target.translation_in_from_frame().z;
    (radial != 0.0).then(|| focal_scaled(camera, &defect(source_from_target)) / radial)
}

/// Circular `L_pla` of the printed alignment over pixels with offsets `d`: neither depth nor the size of `t` enters.
///
/// The directions are those of `f o t'_tan - d delta_z`. NaN where one of them vanishes.
#[must_use]
pub fn planar_loss(camera: &Intrinsics, source_from_target: &Se3, offsets: &[Vector2<f64>]) -> f64 {
    let common = focal_scaled(camera, &source_from_target.translation_in_from_frame());
    let delta_z = defect(source_from_target).z;
    planar::circular(&offsets.iter().map(|d| common - d * delta_z).collect::<Vec<_>>())
}

/// `L_axi` of the printed alignment with the sign of `t_z`, radians: neither depth nor the size of `t` enters.
///
/// The flow at offset `d` points along `-t'_z (d - o)`, `o` the [`focus_offset`]. NaN for `t'_z = 0`.
#[must_use]
pub fn axial_loss(camera: &Intrinsics, source_from_target: &Se3, offsets: &[Vector2<f64>]) -> f64 {
    let offset = focus_offset(camera, source_from_target).unwrap_or(Vector2::repeat(f64::NAN));
    let outward = -source_from_target.translation_in_from_frame().z.signum();
    let flows: Vec<_> = offsets.iter().map(|d| (d - offset) * outward).collect();
    axial::pose_sign(&flows, offsets, source_from_target.translation.z)
}

/// [`planar_loss`] to second order in `delta_z`: `(delta_z / |f o t'_tan|)^2 Var(n x d)`, `n` along `f o t'_tan`.
#[must_use]
pub fn planar_loss_first_order(camera: &Intrinsics, source_from_target: &Se3, offsets: &[Vector2<f64>]) -> f64 {
    let common = focal_scaled(camera, &source_from_target.translation_in_from_frame());
    let n = common / common.norm();
    let centre = mean(offsets.iter().map(|d| n.perp(d)));
    let variance = mean(offsets.iter().map(|d| (n.perp(d) - centre).powi(2)));
    (defect(source_from_target).z / common.norm()).powi(2) * variance
}

/// [`axial_loss`] to first order in the focus offset `o`, radians: `E[|o x d| / r^2]`.
///
/// **Reading**: with `o = f o delta_tan / t'_z`; dividing by `t_z` instead agrees to the same order. NaN for `t'_z = 0`.
#[must_use]
pub fn axial_loss_first_order(camera: &Intrinsics, source_from_target: &Se3, offsets: &[Vector2<f64>]) -> f64 {
    let offset = focus_offset(camera, source_from_target).unwrap_or(Vector2::repeat(f64::NAN));
    mean(offsets.iter().map(|d| offset.perp(d).abs() / d.norm_squared()))
}

/// [`axial_loss`] of a forward motion to first order in the rotation vector, radians: `E[|f_u w_y d_y + f_v w_x d_x| / r^2]`.
///
/// For `t` along the optical axis; the length of `t` does not enter, and roll does not either.
#[must_use]
pub fn forward_axial_loss_first_order(camera: &Intrinsics, omega: &Vector3<f64>, offsets: &[Vector2<f64>]) -> f64 {
    mean(offsets.iter().map(|d| (camera.fu * omega.y * d.y + camera.fv * omega.x * d.x).abs() / d.norm_squared()))
}

/// `(t_x / t'_x, t_y / t'_y)`: what `rho_x t_x / z` and `rho_y t_y / z` are instead of 1, exactly where `delta_z = 0`.
///
/// Infinite or NaN where a component of `t'` vanishes.
#[must_use]
pub fn tangential_ratio_factors(source_from_target: &Se3) -> Vector2<f64> {
    let (t, in_target) = (source_from_target.translation, source_from_target.translation_in_from_frame());
    Vector2::new(t.x / in_target.x, t.y / in_target.y)
}

/// `rho_z t_z / z - 1` to first order in the defect: `((z + t_z) / z) d . o / r^2`, `o` the [`focus_offset`].
///
/// `None` without a focus; not finite at the principal point.
#[must_use]
pub fn radial_ratio_error_first_order(camera: &Intrinsics, source_from_target: &Se3, d: &Vector2<f64>, z: f64) -> Option<f64> {
    let t_z = source_from_target.translation.z;
    focus_offset(camera, source_from_target).map(|o| (z + t_z) / z * d.dot(&o) / d.norm_squared())
}

/// Pixel terms `E[|rho t - z| / z]` of eqs. `lt` (x, y) and `lr` (z) after the printed alignment.
///
/// Not finite where a flow component vanishes, and NaN where a point comes behind the camera.
#[must_use]
pub fn pixel_terms(camera: &Intrinsics, source_from_target: &Se3, pixels: &[Vector2<f64>], depths: &[f64]) -> Vector3<f64> {
    let nowhere = Vector2::repeat(f64::NAN);
    let ratios = |p: &Vector2<f64>, z: f64| {
        let plane = planar_flow(camera, source_from_target, p, z).unwrap_or(nowhere);
        let axis = axial_flow(camera, source_from_target, p, z).unwrap_or(nowhere);
        let tangential = tangential_ratios(camera, &plane);
        Vector3::new(tangential.x, tangential.y, radial_ratio(&axis, &(p - camera.principal_point())))
    };
    let ratios: Vec<_> = pixels.iter().zip(depths).map(|(p, &z)| ratios(p, z)).collect();
    let t = source_from_target.translation;
    Vector3::from_fn(|k, _| pixel_term(&ratios.iter().map(|rho| rho[k]).collect::<Vec<_>>(), depths, t[k]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes;

    #[test]
    fn yaw_and_pitch_cost_the_documented_angle_per_degree() {
        let (camera, d) = (scenes::kitti640(), scenes::road().offsets());
        let per_degree = |w: Vector3<f64>| forward_axial_loss_first_order(&camera, &(w * 1f64.to_radians()), &d);
        assert!((per_degree(Vector3::y()) - 0.0284).abs() < 5e-5);
        assert!((per_degree(Vector3::x()) - 0.0442).abs() < 5e-5);
        assert_eq!(per_degree(Vector3::z()), 0.0);
    }

    #[test]
    fn nothing_is_left_without_rotation() {
        let (camera, motion) = (scenes::kitti640(), scenes::motion([0.0; 3], [0.02, -0.01, -0.8]));
        let d = scenes::road().offsets();
        assert_eq!(defect(&motion), Vector3::zeros());
        assert!(planar_loss(&camera, &motion, &d) < 1e-12 && axial_loss(&camera, &motion, &d) < 1e-12);
        assert_eq!(tangential_ratio_factors(&motion), Vector2::new(1.0, 1.0));
    }
}
