//! The translation that aligned flows and target depths of a whole scene imply, and what a rotation error does to it (L53, L61).

use nalgebra::{Matrix3, Vector2, Vector3};

use crate::camera::Intrinsics;
use crate::ratios;

/// Mean over the pixels of `(z / rho_x, z / rho_y, z / rho_z)`, in the unit of depth; `offsets` are `p - p0`.
///
/// With exact flows it is `t' E[z_hat / z]`: the errors of the depths enter with their signs and may cancel (L53, L54).
///
/// **Panics** when the lists differ in length.
#[must_use]
#[track_caller]
pub fn translation(
    camera: &Intrinsics,
    [planar, axial]: [&[Vector2<f64>]; 2],
    offsets: &[Vector2<f64>],
    depths: &[f64],
) -> Vector3<f64> {
    let lengths = [planar.len(), axial.len(), offsets.len()];
    assert!(lengths == [depths.len(); 3], "recovery::translation: {lengths:?} flows and offsets for {} depths", depths.len());
    let at = |i: usize| ratios::recovered_translation(camera, &planar[i], &axial[i], &offsets[i], depths[i]);
    (0..depths.len()).map(at).sum::<Vector3<f64>>() / depths.len() as f64
}

/// First order of what a rotation error adds to the recovered translation, metres a radian: rows x, y, z, columns of `eps` in
/// `R exp([eps]_x)` (L61).
///
/// **Formula**: `dt_x = E[z x y] eps_x - E[z (1 + x^2)] eps_y + E[z y] eps_z`,
/// `dt_y = E[z (1 + y^2)] eps_x - E[z x y] eps_y - E[z x] eps_z`, and with the same flow `g` of each pixel
/// `dt_z = -E[z d . g / r^2]`, where `(x, y, 1)` is the pixel's ray.
/// **Domain**: exact for `t' = 0`, otherwise to first order in `t' / z` and `eps`; pixels at the principal point add no `dt_z`.
#[must_use]
pub fn rotation_leak(camera: &Intrinsics, pixels: &[Vector2<f64>], depths: &[f64]) -> Matrix3<f64> {
    let at = |(p, &z): (&Vector2<f64>, &f64)| {
        let (ray, d) = (camera.ray(p.x, p.y), p - camera.principal_point());
        let (x, y, squares) = (ray.x, ray.y, d.norm_squared());
        let along_u = Vector3::new(x * y, -(1.0 + x * x), y);
        let along_v = Vector3::new(1.0 + y * y, -x * y, -x);
        let radial = (along_u * (camera.fu * d.x) + along_v * (camera.fv * d.y)) / -squares;
        let radial = if squares > 0.0 { radial } else { Vector3::zeros() };
        Matrix3::from_rows(&[along_u.transpose(), along_v.transpose(), radial.transpose()]) * z
    };
    pixels.iter().zip(depths).map(at).sum::<Matrix3<f64>>() / pixels.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes::{self, Perturbed};
    use crate::so3;

    /// Recovered minus true translation when the rotation alone is off.
    fn error(reference: &scenes::Reference, eps: Vector3<f64>) -> Vector3<f64> {
        let truth = Perturbed::exact(reference);
        let off = Perturbed { omega: so3::log(&(truth.rotation() * so3::exp(&eps))), ..truth.clone() };
        let flows = [off.planar_flows(), off.axial_flows()];
        let found = translation(&off.scene.camera, [&flows[0], &flows[1]], &off.scene.offsets(), &off.target_depths);
        found - truth.in_target
    }

    #[test]
    fn a_tenth_of_a_degree_of_yaw_moves_the_road_by_four_centimetres() {
        let found = error(&scenes::drive_next(), Vector3::new(0.0, 0.1f64.to_radians(), 0.0));
        assert!((found - Vector3::new(-0.0402754003467, -0.000466151520989, -0.0301923978988)).norm() < 1e-9, "{found}");
    }

    #[test]
    fn the_first_order_is_within_five_percent() {
        let scene = scenes::road();
        let leak = rotation_leak(&scene.camera, &scene.pixels, &scene.depths);
        for k in 0..3 {
            let eps = Vector3::ith(k, 1e-5);
            let (found, predicted) = (error(&scenes::drive_next(), eps), leak * eps);
            assert!((found - predicted).norm() < 0.06 * leak.column(k).norm() * 1e-5, "{k}: {found} {predicted}");
        }
    }

    #[test]
    fn a_pixel_at_the_principal_point_stays_finite() {
        let camera = scenes::kitti640();
        let leak = rotation_leak(&camera, &[camera.principal_point()], &[7.0]);
        assert_eq!(leak, Matrix3::new(0.0, -7.0, 0.0, 7.0, 0.0, 0.0, 0.0, 0.0, 0.0));
    }
}
