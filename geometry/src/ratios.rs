//! Depth-to-translation ratios and what can be recovered from them (eqs. `constraint3`, `constraint4`).
//!
//! Ratios are free of scale. The inverse ratios are the ones to compute with: they are linear in the
//! flow (x, y) or bounded away from `p0` (z), where the ratios themselves have poles.

use nalgebra::{Vector2, Vector3};

use crate::camera::Intrinsics;
use crate::flow::tangential::focal_scaled;

/// `rho_x = f_u / f_x`, `rho_y = f_v / f_y` from a planar flow: `z / a_x`, `z / a_y`.
///
/// Infinite where a flow component is zero.
#[must_use]
pub fn tangential_ratios(camera: &Intrinsics, planar_flow: &Vector2<f64>) -> Vector2<f64> {
    Vector2::new(camera.fu / planar_flow.x, camera.fv / planar_flow.y)
}

/// `1/rho_x`, `1/rho_y`; defined for every flow.
#[must_use]
pub fn inverse_tangential_ratios(camera: &Intrinsics, planar_flow: &Vector2<f64>) -> Vector2<f64> {
    Vector2::new(planar_flow.x / camera.fu, planar_flow.y / camera.fv)
}

/// Derivatives of [`tangential_ratios`], each by its own flow component: `-f_u / f_x^2`, `-f_v / f_y^2`, 1 / px (L51).
///
/// **Domain**: flow components that are not zero.
#[must_use]
pub fn tangential_ratio_slopes(camera: &Intrinsics, planar_flow: &Vector2<f64>) -> Vector2<f64> {
    Vector2::new(-camera.fu / planar_flow.x.powi(2), -camera.fv / planar_flow.y.powi(2))
}

/// Derivatives of [`inverse_tangential_ratios`], each by its own flow component: `1 / f_u`, `1 / f_v`, 1 / px (L51).
#[must_use]
pub fn inverse_tangential_ratio_slopes(camera: &Intrinsics) -> Vector2<f64> {
    Vector2::new(camera.fu.recip(), camera.fv.recip())
}

/// `rho_z = -(d.(f + d)) / (d.f)` from an axial flow and `d = p - p0`: `z / a_z`.
///
/// Depends on the radial component of the flow only; infinite or NaN where that vanishes, which
/// includes the principal point.
#[must_use]
pub fn radial_ratio(axial_flow: &Vector2<f64>, d: &Vector2<f64>) -> f64 {
    -d.dot(&(axial_flow + d)) / d.dot(axial_flow)
}

/// `1/rho_z = -(d.f) / (d.(f + d))`; singular only where the flow ends on the principal point.
#[must_use]
pub fn inverse_radial_ratio(axial_flow: &Vector2<f64>, d: &Vector2<f64>) -> f64 {
    -d.dot(axial_flow) / d.dot(&(axial_flow + d))
}

/// Derivative of [`radial_ratio`] by the axial flow: `|d|^2 d / (d.f)^2`, 1 / px (L52).
///
/// **Domain**: `d.f != 0`.
#[must_use]
pub fn radial_ratio_gradient(axial_flow: &Vector2<f64>, d: &Vector2<f64>) -> Vector2<f64> {
    d * (d.norm_squared() / d.dot(axial_flow).powi(2))
}

/// Derivative of [`inverse_radial_ratio`] by the axial flow: `-|d|^2 d / (d.(f + d))^2`, 1 / px (L52).
///
/// **Domain**: `d.(f + d) != 0`.
#[must_use]
pub fn inverse_radial_ratio_gradient(axial_flow: &Vector2<f64>, d: &Vector2<f64>) -> Vector2<f64> {
    d * (-d.norm_squared() / d.dot(&(axial_flow + d)).powi(2))
}

/// Translation that one pixel's flows and target depth imply: `(z/rho_x, z/rho_y, z/rho_z)`.
#[must_use]
pub fn recovered_translation(
    camera: &Intrinsics,
    planar_flow: &Vector2<f64>,
    axial_flow: &Vector2<f64>,
    d: &Vector2<f64>,
    z: f64,
) -> Vector3<f64> {
    let tangential = inverse_tangential_ratios(camera, planar_flow) * z;
    Vector3::new(tangential.x, tangential.y, z * inverse_radial_ratio(axial_flow, d))
}

/// `1 / z` from a planar flow and the tangential translation, along the predicted direction, 1 / m (L55).
///
/// **Formula**: `(F . f_pla) / |F|^2` with `F = f o a_tan`. Both axes share it, so that neither component alone divides; it is
/// linear in the flow, and noise of `sigma` pixels along `F` moves it by `sigma / |F|` wherever the pixel is.
/// **Domain**: `F != 0`.
#[must_use]
pub fn inverse_depth_along_flow(camera: &Intrinsics, planar_flow: &Vector2<f64>, a: &Vector3<f64>) -> f64 {
    let predicted = focal_scaled(camera, a);
    predicted.dot(planar_flow) / predicted.norm_squared()
}

/// Derivative of [`inverse_depth_along_flow`] with respect to the planar flow: `F / |F|^2`, 1 / (m px).
#[must_use]
pub fn inverse_depth_along_flow_slope(camera: &Intrinsics, a: &Vector3<f64>) -> Vector2<f64> {
    let predicted = focal_scaled(camera, a);
    predicted / predicted.norm_squared()
}

/// `rho_z = -(r + f_r) / f_r` from the radial flow component `f_r = d . f / r` at the radius `r`, both pixels (L52).
#[must_use]
pub fn radial_ratio_of_component(f_r: f64, r: f64) -> f64 {
    -(r + f_r) / f_r
}

/// `1 / rho_z = -f_r / (r + f_r)`, from the same.
#[must_use]
pub fn inverse_radial_ratio_of_component(f_r: f64, r: f64) -> f64 {
    -f_r / (r + f_r)
}

/// Radial component of the exact axial flow at radius `r`: `f_r = -t_z r / (z + t_z)`, pixels.
#[must_use]
pub fn radial_flow_component(z: f64, t_z: f64, r: f64) -> f64 {
    -t_z * r / (z + t_z)
}

/// Standard deviation of `rho_z` under pixel noise `sigma`, at radius `r` from the principal point.
///
/// **Formula**: `sigma (z + t_z)^2 / (t_z^2 r)`: the information grows with `r^2`.
#[must_use]
pub fn radial_ratio_noise(sigma: f64, z: f64, t_z: f64, r: f64) -> f64 {
    sigma * (z + t_z).powi(2) / (t_z * t_z * r)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flow::{radial::radial_flow, tangential::tangential_flow};
    use crate::testing;
    use proptest::prelude::*;

    #[test]
    fn reference_values() {
        let (camera, p) = (testing::kitti640(), Vector2::new(451.0, 63.0));
        let d = p - camera.principal_point();
        let flow = tangential_flow(&camera, &Vector3::new(0.3, -0.1, 0.0), 12.5);
        let ratios = tangential_ratios(&camera, &flow);
        assert!((ratios - Vector2::new(41.6666666667, -125.0)).norm() < 1e-9);
        for (t_z, expected) in [(0.6, 20.8333333333), (-0.8, -15.625)] {
            let flow = radial_flow(&camera, t_z, &p, 12.5).unwrap();
            assert!((radial_ratio(&flow, &d) - expected).abs() < 1e-9);
        }
        let flow = Vector2::new(-8.0, 3.0);
        assert!((radial_ratio(&flow, &d) - 14.9110723627).abs() < 1e-9);
        assert!((inverse_radial_ratio(&flow, &d) - 0.0670642577326).abs() < 1e-12);
        let turned = flow + Vector2::new(-d.y, d.x) * 0.3;
        assert!((radial_ratio(&turned, &d) - 14.9110723627).abs() < 1e-9);
        assert!((radial_ratio_noise(0.5, 20.0, -0.8, 2.0) - 144.0).abs() < 1e-10);
    }

    #[test]
    fn inverse_ratios_stay_finite_without_flow() {
        let camera = testing::kitti640();
        assert_eq!(inverse_tangential_ratios(&camera, &Vector2::zeros()), Vector2::zeros());
        assert_eq!(inverse_radial_ratio(&Vector2::zeros(), &Vector2::new(3.0, 4.0)), 0.0);
    }

    proptest! {
        #[test]
        fn exact_flows_give_back_the_translation(case in testing::case()) {
            let (t, z) = (case.motion.translation, case.depth);
            let d = case.pixel - case.camera.principal_point();
            prop_assume!(d.norm() > 5.0 && t.iter().all(|x| x.abs() > 0.01 * z));
            let planar = tangential_flow(&case.camera, &t, z);
            let axial = radial_flow(&case.camera, t.z, &case.pixel, z).unwrap();
            let back = recovered_translation(&case.camera, &planar, &axial, &d, z);
            prop_assert!((back - t).norm() < 1e-12 * z);
            prop_assert!((radial_ratio(&axial, &d) * t.z / z - 1.0).abs() < 1e-12);
            let ratios = tangential_ratios(&case.camera, &planar);
            prop_assert!((ratios.x * t.x / z - 1.0).abs() < 1e-12);
        }

        #[test]
        fn noise_formula_is_the_derivative(r in 5.0f64..400.0, z in 1.0f64..50.0, t in -0.3f64..0.3) {
            let t_z = t * z;
            let d = Vector2::new(r, 0.0);
            let f = -t_z / (z + t_z) * r;
            prop_assume!(f.abs() > 1e-2);
            let h = 1e-5 * f.abs();
            let at = |f| radial_ratio(&Vector2::new(f, 0.0), &d);
            let slope = (at(f + h) - at(f - h)) / (2.0 * h);
            prop_assert!((slope / radial_ratio_noise(1.0, z, t_z, r) - 1.0).abs() < 1e-6);
        }
    }
}
