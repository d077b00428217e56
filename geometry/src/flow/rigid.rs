//! Flow of a static scene under any rigid motion (eq. `p_s`).

use nalgebra::{Vector2, Vector3};

use super::translational::translational_flow;
use crate::camera::Intrinsics;
use crate::homography::{rotation_homography, transfer};
use crate::se3::Se3;

/// Flow and source depth of the target pixel `p` at target depth `z`.
///
/// **Formula** (eq. `p_s`): `z_s p~_s = K (z R K^-1 p~ + t)`, `f = p_s - p`.
/// **Reading**: the division is by the transformed depth `z_s`, not by a predicted source depth.
/// `None` unless `z_s > 0`.
#[must_use]
pub fn rigid_flow(camera: &Intrinsics, source_from_target: &Se3, p: &Vector2<f64>, z: f64) -> Option<(Vector2<f64>, f64)> {
    let point = source_from_target.transform(&(camera.ray(p.x, p.y) * z));
    let pixel = camera.project(&point)?;
    Some((pixel - p, point.z))
}

/// Homogeneous source pixel of eq. `p_s` as printed, divided by a source depth that was predicted.
///
/// **Formula**: `(1 / z_hat) K (z R K^-1 p~ + t)`; the third component is `z_s / z_hat`.
/// **Reading**: this is a pixel `(u, v, 1)` only where the prediction `z_hat` equals the transformed depth `z_s`. Dividing by the
/// third component mends it and takes `z_hat` out again. For comparison only.
#[must_use]
pub fn printed_correspondence(
    camera: &Intrinsics,
    source_from_target: &Se3,
    p: &Vector2<f64>,
    z: f64,
    predicted_source_depth: f64,
) -> Vector3<f64> {
    camera.matrix() * source_from_target.transform(&(camera.ray(p.x, p.y) * z)) / predicted_source_depth
}

/// The same flow as the rotational flow plus the translational flow at the rotated pixel.
///
/// **Formula**: with `p_R = pi(H p~)` and `z_R = z h_3 p~`,
/// `f = (p_R - p) + [f o t - (p_R - p0) t_z] / (z_R + t_z)`.
#[must_use]
pub fn rigid_flow_by_parts(
    camera: &Intrinsics,
    source_from_target: &Se3,
    p: &Vector2<f64>,
    z: f64,
) -> Option<(Vector2<f64>, Vector2<f64>)> {
    let h = rotation_homography(camera, &source_from_target.rotation);
    let (rotated, ratio) = transfer(&h, p)?;
    let translational = translational_flow(camera, &source_from_target.translation, &rotated, z * ratio)?;
    Some((rotated - p, translational))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;
    use proptest::prelude::*;

    #[test]
    fn reference_values() {
        let (camera, p) = (testing::kitti640(), Vector2::new(451.0, 63.0));
        let motion = Se3::from_rotation_vector(&Vector3::new(0.02, -0.03, 0.01), Vector3::new(0.3, -0.1, 0.6));
        let (flow, z_s) = rigid_flow(&camera, &motion, &p, 12.5).unwrap();
        assert!((flow + p - Vector2::new(442.221149965, 56.1345809123)).norm() < 1e-8);
        assert!((z_s - 13.2024207032).abs() < 1e-9);
        let motion = Se3::from_rotation_vector(&Vector3::new(0.03, -0.05, 0.02), Vector3::new(0.3, -0.1, 0.6));
        let (flow, _) = rigid_flow(&camera, &motion, &p, 12.5).unwrap();
        assert!((flow - Vector2::new(-16.0849042832, -9.07775325806)).norm() < 1e-8);
        assert!(rigid_flow(&camera, &motion, &p, -12.5).is_none());
    }

    #[test]
    fn translation_comes_off_first() {
        // What is left after subtracting t from the source point is the pure homography flow.
        let (camera, p) = (testing::kitti640(), Vector2::new(451.0, 63.0));
        let motion = Se3::from_rotation_vector(&Vector3::new(0.03, -0.05, 0.02), Vector3::new(0.06, 0.04, -0.08));
        let point = motion.transform(&(camera.ray(p.x, p.y) * 12.5)) - motion.translation;
        let pixel = camera.project(&point).unwrap();
        assert!((pixel - Vector2::new(431.567088882, 54.8393440356)).norm() < 1e-8);
    }

    proptest! {
        #[test]
        fn parts_add_up(case in testing::case()) {
            let whole = rigid_flow(&case.camera, &case.motion, &case.pixel, case.depth).unwrap().0;
            let (rotational, translational) =
                rigid_flow_by_parts(&case.camera, &case.motion, &case.pixel, case.depth).unwrap();
            prop_assert!((whole - rotational - translational).norm() < 1e-9);
        }

        #[test]
        fn depth_does_not_enter_without_translation(case in testing::case()) {
            let motion = Se3 { translation: Vector3::zeros(), ..case.motion };
            let near = rigid_flow(&case.camera, &motion, &case.pixel, 5.0).unwrap().0;
            let far = rigid_flow(&case.camera, &motion, &case.pixel, 50.0).unwrap().0;
            prop_assert!((near - far).norm() < 1e-10);
        }
    }
}
