//! Derivatives of the translational flow (eqs. `grad_z`, `grad_tx`, `grad_ty`, `grad_tz`).

use nalgebra::{Vector2, Vector3};

use super::tangential::{focal_scaled, tangential_flow};
use super::translational::focus_of_expansion;
use crate::camera::Intrinsics;
use crate::homography::{rotation_homography, transfer};
use crate::se3::Se3;

/// Partial derivatives of the flow at one pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TranslationalGradients {
    /// With respect to the target depth, pixels per depth unit (eq. `grad_z`).
    pub z: Vector2<f64>,
    /// With respect to `t_x` (eq. `grad_tx`).
    pub t_x: Vector2<f64>,
    /// With respect to `t_y` (eq. `grad_ty`).
    pub t_y: Vector2<f64>,
    /// With respect to `t_z` (eq. `grad_tz`).
    pub t_z: Vector2<f64>,
}

/// Gradients of the flow of translation `t` without rotation; `None` unless `z + t_z > 0`.
///
/// **Formula**: `df/dz = -[f o t - d t_z] / (z + t_z)^2`, `df/dt_x = (f_u, 0) / (z + t_z)`,
/// `df/dt_y = (0, f_v) / (z + t_z)`, `df/dt_z = -[d z + f o t] / (z + t_z)^2`, `d = p - p0`.
/// **Reading**: the depth gradient vanishes at the focus of expansion, which is the principal point
/// only when there is no tangential translation.
#[must_use]
pub fn translational_gradients(
    camera: &Intrinsics,
    t: &Vector3<f64>,
    p: &Vector2<f64>,
    z: f64,
) -> Option<TranslationalGradients> {
    let source_depth = z + t.z;
    let (d, tangential) = (p - camera.principal_point(), focal_scaled(camera, t));
    let square = source_depth * source_depth;
    (source_depth > 0.0).then(|| TranslationalGradients {
        z: -(tangential - d * t.z) / square,
        t_x: Vector2::new(camera.fu / source_depth, 0.0),
        t_y: Vector2::new(0.0, camera.fv / source_depth),
        t_z: -(d * z + tangential) / square,
    })
}

/// The same derivatives for a motion with rotation, with respect to the target depth and the parts of `t` in the source frame.
///
/// **Formula**: with `p_R = pi(H p~)`, `h = h_3 p~` and `z_R = z h`, `df/dz = -h [f o t - (p_R - p0) t_z] / (z_R + t_z)^2`; the
/// others are those of [`translational_gradients`] at `p_R` and `z_R`.
/// `None` unless `h > 0` and `z_R + t_z > 0`.
#[must_use]
pub fn rigid_gradients(
    camera: &Intrinsics,
    source_from_target: &Se3,
    p: &Vector2<f64>,
    z: f64,
) -> Option<TranslationalGradients> {
    let (rotated, ratio) = transfer(&rotation_homography(camera, &source_from_target.rotation), p)?;
    let gradients = translational_gradients(camera, &source_from_target.translation, &rotated, z * ratio)?;
    Some(TranslationalGradients { z: gradients.z * ratio, ..gradients })
}

/// Length of `df/dz` from the distance to the focus of expansion `e`, pixels per depth unit, without rotation.
///
/// **Formula** (L21): `|df/dz| = |t_z| |p - e| / (z + t_z)^2`. `None` without a focus (`t_z = 0`) and unless `z + t_z > 0`.
#[must_use]
pub fn depth_gradient_about_focus(camera: &Intrinsics, t: &Vector3<f64>, p: &Vector2<f64>, z: f64) -> Option<f64> {
    let source_depth = z + t.z;
    let focus = focus_of_expansion(camera, t)?;
    (source_depth > 0.0).then(|| t.z.abs() * (p - focus).norm() / (source_depth * source_depth))
}

/// Length of `df/dz` at the principal point, pixels per depth unit, without rotation: the tangential translation's share.
///
/// **Formula** (L21): `|f o t_tan| / (z + t_z)^2`. `None` unless `z + t_z > 0`.
#[must_use]
pub fn depth_gradient_at_principal_point(camera: &Intrinsics, t: &Vector3<f64>, z: f64) -> Option<f64> {
    let source_depth = z + t.z;
    (source_depth > 0.0).then(|| focal_scaled(camera, t).norm() / (source_depth * source_depth))
}

/// How much the radial translation changes the gradients of the tangential one, per depth unit: `d ln |df/dt_x| / dt_z`.
///
/// **Formula** (L22): `-1 / (z + t_z)`, the same for `t_y`: the direction stays, the size changes by `t_z / z` to first order.
/// **Domain**: `z + t_z > 0`.
#[must_use]
pub fn radial_influence(z: f64, t_z: f64) -> f64 {
    -1.0 / (z + t_z)
}

/// Mixed second derivatives `d2f / dt_x dt_z` and `d2f / dt_y dt_z`, pixels per squared depth unit, without rotation.
///
/// **Formula** (L22): `-(f_u, 0) / (z + t_z)^2`, `-(0, f_v) / (z + t_z)^2`. **Domain**: `z + t_z > 0`.
#[must_use]
pub fn mixed_second_derivatives(camera: &Intrinsics, z: f64, t_z: f64) -> [Vector2<f64>; 2] {
    let square = (z + t_z) * (z + t_z);
    [Vector2::new(-camera.fu / square, 0.0), Vector2::new(0.0, -camera.fv / square)]
}

/// Share of the tangential translation in `df/dt_z = -[d z + f o t_tan] / (z + t_z)^2`, relative to that of the pixel's offset.
///
/// **Formula** (L22): `|f o t_tan| / (r z)`, `r = |p - p0|`; infinite or NaN at the principal point. **Domain**: `z > 0`.
#[must_use]
pub fn tangential_influence(camera: &Intrinsics, t: &Vector3<f64>, p: &Vector2<f64>, z: f64) -> f64 {
    tangential_influence_radius(camera, t, z) / (p - camera.principal_point()).norm()
}

/// Distance from the principal point, pixels, below which the tangential translation dominates `df/dt_z`.
///
/// **Formula** (L22): `|f o t_tan| / z`, the length of the tangential flow. **Domain**: `z > 0`.
#[must_use]
pub fn tangential_influence_radius(camera: &Intrinsics, t: &Vector3<f64>, z: f64) -> f64 {
    tangential_flow(camera, t, z).norm()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flow::translational::{focus_of_expansion, translational_flow};
    use crate::testing;
    use proptest::prelude::*;

    #[test]
    fn reference_values() {
        let (camera, t) = (testing::kitti640(), Vector3::new(0.3, -0.1, 0.6));
        let g = translational_gradients(&camera, &t, &Vector2::new(451.0, 63.0), 12.5).unwrap();
        assert!((g.z - Vector2::new(-0.190897966319, 0.0994347648738)).norm() < 1e-11);
        assert!((g.t_x.x - 28.3358778626).abs() < 1e-9 && (g.t_y.y - 28.1404580153).abs() < 1e-9);
        assert!((g.t_z - Vector2::new(-10.1908979663, 2.61851873434)).norm() < 1e-9);
    }

    #[test]
    fn reference_values_with_rotation() {
        let motion = Se3::from_rotation_vector(&Vector3::new(0.03, -0.05, 0.02), Vector3::new(0.3, -0.1, 0.6));
        let g = rigid_gradients(&testing::kitti640(), &motion, &Vector2::new(451.0, 63.0), 12.5).unwrap();
        assert!((g.z - Vector2::new(-0.255727934023, 0.0700498558718)).norm() < 1e-11);
        assert!(rigid_gradients(&testing::kitti640(), &motion, &Vector2::new(451.0, 63.0), -12.5).is_none());
    }

    #[test]
    fn depth_gradient_vanishes_at_the_focus_not_at_the_principal_point() {
        let (camera, t) = (testing::kitti640(), Vector3::new(0.3, 0.0, -0.8));
        let focus = focus_of_expansion(&camera, &t).unwrap();
        let at = |p| translational_gradients(&camera, &t, &p, 12.5).unwrap().z.norm();
        assert!((focus.x - (320.0 - 139.2)).abs() < 1e-9);
        assert!(at(focus) < 1e-12);
        assert!((at(camera.principal_point()) - 0.8135).abs() < 1e-4);
    }

    proptest! {
        #[test]
        fn match_central_differences(case in testing::case()) {
            let (t, z, p) = (case.motion.translation, case.depth, case.pixel);
            let f = |t: Vector3<f64>, z: f64| translational_flow(&case.camera, &t, &p, z).unwrap();
            let g = translational_gradients(&case.camera, &t, &p, z).unwrap();
            let h = 1e-6 * z;
            let scale = case.camera.fu.max(case.camera.fv) / (z + t.z);
            let difference = |dt: Vector3<f64>, dz: f64| (f(t + dt * h, z + dz * h) - f(t - dt * h, z - dz * h)) / (2.0 * h);
            for (analytic, numeric) in [
                (g.z, difference(Vector3::zeros(), 1.0)),
                (g.t_x, difference(Vector3::x(), 0.0)),
                (g.t_y, difference(Vector3::y(), 0.0)),
                (g.t_z, difference(Vector3::z(), 0.0)),
            ] {
                prop_assert!((analytic - numeric).norm() < 1e-6 * scale * (1.0 + p.norm() / case.camera.fu));
            }
        }
    }
}
