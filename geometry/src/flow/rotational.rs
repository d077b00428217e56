//! Flow of a pure rotation (eq. `rotational_flow`): free of depth.

use nalgebra::{Matrix3, Vector2, Vector3};

use crate::camera::Intrinsics;
use crate::homography::rotation_homography;

/// Quadratic part `p~^T (-h_3 i_k^T) p~` of the numerator of eq. `rotational_flow`, for both components.
///
/// **Reading**: written out it is `-(h_31 u^2 + h_32 u v + h_33 u)` and
/// `-(h_31 u v + h_32 v^2 + h_33 v)`; the expansion printed in the text lacks both minus signs.
#[must_use]
pub fn quadratic_terms(homography: &Matrix3<f64>, p: &Vector2<f64>) -> Vector2<f64> {
    let third = homography.row(2);
    *p * -(third[0] * p.x + third[1] * p.y + third[2])
}

/// The expansion as the text prints it, `h_31 u^2 + h_32 u v + h_33 u` and `h_31 u v + h_32 v^2 + h_33 v`: the negative of
/// [`quadratic_terms`]. For comparison only.
#[must_use]
pub fn printed_quadratic_terms(homography: &Matrix3<f64>, p: &Vector2<f64>) -> Vector2<f64> {
    let (u, v) = (p.x, p.y);
    let (h_31, h_32, h_33) = (homography[(2, 0)], homography[(2, 1)], homography[(2, 2)]);
    Vector2::new(h_31 * u * u + h_32 * u * v + h_33 * u, h_31 * u * v + h_32 * v * v + h_33 * v)
}

/// Flow caused by the rotation `R` of `source_from_target`.
///
/// **Formula** (eq. `rotational_flow`): `f_k = [p~^T (-h_3 i_k^T) p~ + h_k p~] / (h_3 p~)`.
/// `None` where `h_3 p~ <= 0`: the point turns out of the front of the camera.
#[must_use]
pub fn rotational_flow(camera: &Intrinsics, rotation: &Matrix3<f64>, p: &Vector2<f64>) -> Option<Vector2<f64>> {
    let h = rotation_homography(camera, rotation);
    let image = h * Vector3::new(p.x, p.y, 1.0);
    let linear = Vector2::new(image.x, image.y);
    (image.z > 0.0).then(|| (quadratic_terms(&h, p) + linear) / image.z)
}

/// Second difference `f(p - s) - 2 f(p) + f(p + s)` of the rotational flow for a step `s`, pixels.
///
/// **Formula**: with `n = (h_1 . p~, h_2 . p~)`, `w = h_3 . p~` and their changes `dn`, `dw` over one step,
/// `2 dw (n dw - dn w) / [w (w^2 - dw^2)]`. It vanishes exactly where `dw = 0`: the flow is affine in the pixel when
/// `h_31 = h_32 = 0`, that is for rotations about the optical axis, and only then.
/// `None` unless all three pixels stay in front of the camera.
#[must_use]
pub fn rotational_bend(homography: &Matrix3<f64>, p: &Vector2<f64>, step: &Vector2<f64>) -> Option<Vector2<f64>> {
    let (image, change) = (homography * Vector3::new(p.x, p.y, 1.0), homography * Vector3::new(step.x, step.y, 0.0));
    let (w, dw) = (image.z, change.z);
    (w > dw.abs()).then(|| (image.xy() * dw - change.xy() * w) * (2.0 * dw / (w * (w * w - dw * dw))))
}

/// First-order flow of a small rotation vector; the error grows with the square of the angle.
///
/// **Formula**: `f_u (w_y (1 + x^2) - w_x x y - w_z y)`, `f_v (-w_x (1 + y^2) + w_y x y + w_z x)`
/// with the viewing ray `(x, y, 1)`.
#[must_use]
pub fn rotational_flow_first_order(camera: &Intrinsics, omega: &Vector3<f64>, p: &Vector2<f64>) -> Vector2<f64> {
    let ray = camera.ray(p.x, p.y);
    let (x, y) = (ray.x, ray.y);
    Vector2::new(
        camera.fu * (omega.y * (1.0 + x * x) - omega.x * x * y - omega.z * y),
        camera.fv * (-omega.x * (1.0 + y * y) + omega.y * x * y + omega.z * x),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{so3, testing};
    use proptest::prelude::*;

    const P: Vector2<f64> = Vector2::new(451.0, 63.0);

    #[test]
    fn reference_values() {
        let camera = testing::kitti640();
        let flow = |w: [f64; 3], p| rotational_flow(&camera, &so3::exp(&Vector3::from(w)), &p).unwrap();
        let near = |a: Vector2<f64>, x, y| assert!((a - Vector2::new(x, y)).norm() < 1e-9, "{a}");
        near(flow([0.03, -0.05, 0.02], P), -19.4329111175, -8.16065596442);
        near(flow([0.0, 0.0, 0.05], P), 1.4970502573, 6.54335898712);
        let yaw = [0.0, 1f64.to_radians(), 0.0];
        for (u, expected) in [(8.0, 10.8968890606), (320.0, 6.47932010135), (632.0, 11.2213926313)] {
            assert!((flow(yaw, Vector2::new(u, 96.0)).x - expected).abs() < 1e-9);
        }
    }

    #[test]
    fn quadratic_terms_carry_a_minus_sign() {
        let camera = testing::kitti640();
        let h = rotation_homography(&camera, &so3::exp(&Vector3::new(0.03, -0.05, 0.02)));
        let terms = quadratic_terms(&h, &P);
        assert!((terms - Vector2::new(-457.044111215, -63.8442993493)).norm() < 1e-8);
    }

    #[test]
    fn roll_is_affine_and_yaw_is_not() {
        let camera = testing::kitti640();
        let bend = |w: Vector3<f64>| {
            let f = |u: f64| rotational_flow(&camera, &so3::exp(&w), &Vector2::new(u, 40.0)).unwrap();
            (f(100.0) - f(300.0) * 2.0 + f(500.0)).norm()
        };
        assert!(bend(Vector3::new(0.0, 0.0, 0.1)) < 1e-10);
        assert!(bend(Vector3::new(0.0, 0.01, 0.0)) > 1e-6);
    }

    proptest! {
        #[test]
        fn equals_the_full_projection(case in testing::case()) {
            let point = case.motion.rotation * case.camera.ray(case.pixel.x, case.pixel.y) * case.depth;
            let expected = case.camera.project(&point).unwrap() - case.pixel;
            let flow = rotational_flow(&case.camera, &case.motion.rotation, &case.pixel).unwrap();
            prop_assert!((flow - expected).norm() < 1e-10);
        }

        #[test]
        fn first_order_error_is_quadratic(case in testing::case()) {
            let ray = case.camera.ray(case.pixel.x, case.pixel.y);
            prop_assume!(ray.x.abs() <= 1.2 && ray.y.abs() <= 1.2);
            let omega = so3::log(&case.motion.rotation);
            let exact = rotational_flow(&case.camera, &case.motion.rotation, &case.pixel).unwrap();
            let linear = rotational_flow_first_order(&case.camera, &omega, &case.pixel);
            let size = case.camera.fu.max(case.camera.fv) * ray.norm().powi(3);
            prop_assert!((exact - linear).norm() <= 2.0 * size * omega.norm_squared() + 1e-10);
        }
    }
}
