//! Flow of a translation along the optical axis (eqs. `radial_correspondence`, `radial_flow`).

use nalgebra::Vector2;

use crate::camera::Intrinsics;

/// Flow of the translation `(0, 0, t_z)`; `None` unless `z + t_z > 0`.
///
/// **Formula** (eq. `radial_flow`): `f = -t_z / (z + t_z) (p - p0)`: toward the principal point for
/// `t_z > 0`, away from it for `t_z < 0`, zero at it.
#[must_use]
pub fn radial_flow(camera: &Intrinsics, t_z: f64, p: &Vector2<f64>, z: f64) -> Option<Vector2<f64>> {
    let source_depth = z + t_z;
    (source_depth > 0.0).then(|| (p - camera.principal_point()) * (-t_z / source_depth))
}

/// Factor by which a radial translation scales the image: `z / (z + t_z)`.
///
/// **Reading**: its difference from 1 is exactly `-t_z / z_s`, inverse to the SOURCE depth; inverse to
/// the target depth only to first order in `t_z / z`.
#[must_use]
pub fn scale_change(z: f64, t_z: f64) -> f64 {
    z / (z + t_z)
}

/// [`scale_change`] to first order in `t_z / z`, the form the introduction speaks of: `1 - t_z / z`.
///
/// Off by `t_z^2 / [z (z + t_z)]`.
#[must_use]
pub fn scale_change_first_order(z: f64, t_z: f64) -> f64 {
    1.0 - t_z / z
}

/// Derivative of [`scale_change`] by `t_z`: `-z / (z + t_z)^2`, at `t_z = 0` the `-1 / z` of the first order.
#[must_use]
pub fn scale_change_slope(z: f64, t_z: f64) -> f64 {
    -z / ((z + t_z) * (z + t_z))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;
    use nalgebra::Vector3;
    use proptest::prelude::*;

    #[test]
    fn reference_values() {
        let (camera, p) = (testing::kitti640(), Vector2::new(451.0, 63.0));
        for (t_z, expected) in [(0.6, Vector2::new(-6.0, 1.51145038168)), (-0.8, Vector2::new(8.95726495726, -2.25641025641))] {
            assert!((radial_flow(&camera, t_z, &p, 12.5).unwrap() - expected).norm() < 1e-10);
        }
        assert!((scale_change(5.0, -0.8) - 1.0 - 0.190476190476).abs() < 1e-12);
        assert!(radial_flow(&camera, -12.5, &p, 12.5).is_none());
        assert_eq!(radial_flow(&camera, 3.0, &camera.principal_point(), 9.0), Some(Vector2::zeros()));
    }

    proptest! {
        #[test]
        fn equals_the_projection_and_points_along_the_radius(case in testing::case()) {
            let t_z = case.motion.translation.z;
            let point = case.camera.ray(case.pixel.x, case.pixel.y) * case.depth + Vector3::new(0.0, 0.0, t_z);
            let expected = case.camera.project(&point).unwrap() - case.pixel;
            let flow = radial_flow(&case.camera, t_z, &case.pixel, case.depth).unwrap();
            prop_assert!((flow - expected).norm() < 1e-10);
            let d = case.pixel - case.camera.principal_point();
            prop_assert!(flow.perp(&d).abs() <= 1e-10 * d.norm() * flow.norm());
            prop_assert!(flow.dot(&d) * t_z <= 0.0);
            let change = (scale_change(case.depth, t_z) - 1.0) * (case.depth + t_z);
            prop_assert!((change + t_z).abs() < 1e-13 * case.depth);
        }
    }
}
