//! Flow of a whole translation without rotation, and its focus.

use nalgebra::{Vector2, Vector3};

use super::radial::{radial_flow, scale_change};
use super::tangential::{focal_scaled, tangential_flow};
use crate::camera::Intrinsics;

/// Flow of the translation `t` without rotation; `None` unless `z + t_z > 0`.
///
/// **Formula**: `f = [f o t - (p - p0) t_z] / (z + t_z)`.
/// **Reading**: not the sum of the tangential and the radial flow; the tangential one is multiplied by
/// `z / (z + t_z)` first.
#[must_use]
pub fn translational_flow(camera: &Intrinsics, t: &Vector3<f64>, p: &Vector2<f64>, z: f64) -> Option<Vector2<f64>> {
    let source_depth = z + t.z;
    let d = p - camera.principal_point();
    (source_depth > 0.0).then(|| (focal_scaled(camera, t) - d * t.z) / source_depth)
}

/// Focus of expansion `e = p0 + (f o t) / t_z`, the pixel without flow; `None` for `t_z = 0`.
#[must_use]
pub fn focus_of_expansion(camera: &Intrinsics, t: &Vector3<f64>) -> Option<Vector2<f64>> {
    (t.z != 0.0).then(|| camera.principal_point() + focal_scaled(camera, t) / t.z)
}

/// The same flow about its focus: `f = -t_z / (z + t_z) (p - e)`; `None` for `t_z = 0` and unless `z + t_z > 0`.
#[must_use]
pub fn flow_about_focus(camera: &Intrinsics, t: &Vector3<f64>, p: &Vector2<f64>, z: f64) -> Option<Vector2<f64>> {
    let focus = focus_of_expansion(camera, t)?;
    (z + t.z > 0.0).then(|| (p - focus) * (-t.z / (z + t.z)))
}

/// The same flow from the flows of both parts: `f = z / (z + t_z) f_tan + f_rad`; `None` unless `z + t_z > 0`.
#[must_use]
pub fn flow_from_parts(camera: &Intrinsics, t: &Vector3<f64>, p: &Vector2<f64>, z: f64) -> Option<Vector2<f64>> {
    Some(tangential_flow(camera, t, z) * scale_change(z, t.z) + radial_flow(camera, t.z, p, z)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;
    use proptest::prelude::*;

    #[test]
    fn reference_values() {
        let (camera, t, p) = (testing::kitti640(), Vector3::new(0.3, -0.1, 0.6), Vector2::new(451.0, 63.0));
        let flow = translational_flow(&camera, &t, &p, 12.5).unwrap();
        assert!((flow - Vector2::new(2.50076335878, -1.30259541985)).norm() < 1e-10);
        let sum = tangential_flow(&camera, &t, 12.5) + radial_flow(&camera, 0.6, &p, 12.5).unwrap();
        assert!((sum - flow - Vector2::new(0.408036641221, -0.135074198473)).norm() < 1e-10);
        let focus = focus_of_expansion(&camera, &t).unwrap();
        assert!((focus - Vector2::new(505.6, 34.56)).norm() < 1e-10);
        assert!(translational_flow(&camera, &t, &focus, 4.0).unwrap().norm() < 1e-12);
    }

    proptest! {
        #[test]
        fn equals_the_projection_and_the_weighted_sum(case in testing::case()) {
            let (t, z) = (case.motion.translation, case.depth);
            let point = case.camera.ray(case.pixel.x, case.pixel.y) * z + t;
            let flow = translational_flow(&case.camera, &t, &case.pixel, z).unwrap();
            let expected = case.camera.project(&point).unwrap() - case.pixel;
            prop_assert!((flow - expected).norm() < 1e-10);
            let parts = tangential_flow(&case.camera, &t, z) * (z / (z + t.z))
                + radial_flow(&case.camera, t.z, &case.pixel, z).unwrap();
            prop_assert!((flow - parts).norm() < 1e-10);
        }
    }
}
