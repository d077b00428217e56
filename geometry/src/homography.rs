//! The homography of a pure rotation (eqs. `rotational_correspondence`, `_h`).

use nalgebra::{Matrix3, Vector2, Vector3};

use crate::camera::Intrinsics;

/// `H = K R K^-1`: carries homogeneous target pixels to source pixels when only the orientation changed.
#[must_use]
pub fn rotation_homography(camera: &Intrinsics, rotation: &Matrix3<f64>) -> Matrix3<f64> {
    camera.matrix() * rotation * camera.inverse_matrix()
}

/// Image of pixel `p` under a homography, and the third homogeneous coordinate `h_3 p~`.
///
/// For [`rotation_homography`] that coordinate is `z_s / z_t`. `None` when it is not positive: the
/// point leaves the front of the camera.
#[must_use]
pub fn transfer(homography: &Matrix3<f64>, p: &Vector2<f64>) -> Option<(Vector2<f64>, f64)> {
    let image = homography * Vector3::new(p.x, p.y, 1.0);
    (image.z > 0.0).then(|| (Vector2::new(image.x / image.z, image.y / image.z), image.z))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{so3, testing};
    use proptest::prelude::*;

    #[test]
    fn reference_values() {
        let camera = testing::kitti640();
        let h = rotation_homography(&camera, &so3::exp(&Vector3::new(0.03, -0.05, 0.02)));
        let third = [0.000135420916922, 7.99727699733e-05, 0.947288458933];
        for (k, expected) in third.into_iter().enumerate() {
            assert!((h[(2, k)] - expected).abs() < 1e-11 * expected.abs());
        }
        let (p, ratio) = transfer(&h, &Vector2::new(451.0, 63.0)).unwrap();
        assert!((p - Vector2::new(431.567088882, 54.8393440356)).norm() < 1e-8);
        assert!((ratio - 1.01340157697).abs() < 1e-11);
    }

    proptest! {
        #[test]
        fn equals_the_projection_at_any_depth(case in testing::case(), z in 0.5f64..80.0) {
            let h = rotation_homography(&case.camera, &case.motion.rotation);
            let (p, ratio) = transfer(&h, &case.pixel).unwrap();
            let point = case.motion.rotation * case.camera.ray(case.pixel.x, case.pixel.y) * z;
            prop_assert!((case.camera.project(&point).unwrap() - p).norm() < 1e-10);
            prop_assert!((ratio * z - point.z).abs() < 1e-12 * z);
        }
    }
}
