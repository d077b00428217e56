//! Flow of a translation parallel to the image plane (eqs. `tangential_correspondence`, `tangential_flow`).

use nalgebra::{Vector2, Vector3};

use crate::camera::Intrinsics;

/// `f o a = (f_u a_x, f_v a_y)`: the tangential part of a translation in pixels times depth.
#[must_use]
pub fn focal_scaled(camera: &Intrinsics, translation: &Vector3<f64>) -> Vector2<f64> {
    Vector2::new(camera.fu * translation.x, camera.fv * translation.y)
}

/// Flow of the translation `(t_x, t_y, 0)` at target depth `z > 0`.
///
/// **Formula** (eq. `tangential_flow`): `f = (f o t) / z`. All flows are parallel; the third
/// component of `translation` is not looked at.
#[must_use]
pub fn tangential_flow(camera: &Intrinsics, translation: &Vector3<f64>, z: f64) -> Vector2<f64> {
    focal_scaled(camera, translation) / z
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;
    use proptest::prelude::*;

    #[test]
    fn reference_value() {
        let flow = tangential_flow(&testing::kitti640(), &Vector3::new(0.3, -0.1, 0.6), 12.5);
        assert!((flow - Vector2::new(8.9088, -2.94912)).norm() < 1e-12);
    }

    proptest! {
        #[test]
        fn equals_the_projection_and_scales_with_inverse_depth(case in testing::case()) {
            let mut t = case.motion.translation;
            t.z = 0.0;
            let point = case.camera.ray(case.pixel.x, case.pixel.y) * case.depth + t;
            let expected = case.camera.project(&point).unwrap() - case.pixel;
            let flow = tangential_flow(&case.camera, &t, case.depth);
            prop_assert!((flow - expected).norm() < 1e-10);
            let twice = tangential_flow(&case.camera, &t, 2.0 * case.depth);
            prop_assert!((twice * 2.0 - flow).norm() < 1e-12 * flow.norm());
        }
    }
}
