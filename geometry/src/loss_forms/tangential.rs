//! Agreement of planar flow, depth and tangential translation (eq. `lt`).

use nalgebra::{Vector2, Vector3};

use super::mean;
use super::ratio_terms::{aggregate_term, pixel_term};
use crate::camera::Intrinsics;
use crate::flow::tangential::tangential_flow;
use crate::ratios::{inverse_tangential_ratios, tangential_ratios};

/// Eq. `lt` as printed: pixel and aggregate terms of both axes, without unit.
///
/// Not finite when a translation component or a flow component is zero.
#[must_use]
pub fn printed(camera: &Intrinsics, flows: &[Vector2<f64>], depths: &[f64], a: &Vector3<f64>) -> f64 {
    printed_terms(camera, flows, depths, a).iter().sum()
}

/// The four terms of [`printed`]: pixel and aggregate along u, pixel and aggregate along v.
#[must_use]
pub fn printed_terms(camera: &Intrinsics, flows: &[Vector2<f64>], depths: &[f64], a: &Vector3<f64>) -> [f64; 4] {
    let axis = |k: usize| {
        let ratios: Vec<_> = flows.iter().map(|f| tangential_ratios(camera, f)[k]).collect();
        let inverse: Vec<_> = flows.iter().map(|f| inverse_tangential_ratios(camera, f)[k]).collect();
        [pixel_term(&ratios, depths, a[k]), aggregate_term(&inverse, depths, a[k])]
    };
    let [[pixel_x, aggregate_x], [pixel_y, aggregate_y]] = [axis(0), axis(1)];
    [pixel_x, aggregate_x, pixel_y, aggregate_y]
}

/// `sum_k E[|z/rho_k - a_k|] / |a|`, k = x, y: linear in the flow, no small denominators.
#[must_use]
pub fn inverse_ratio(camera: &Intrinsics, flows: &[Vector2<f64>], depths: &[f64], a: &Vector3<f64>) -> f64 {
    let residual =
        |k: usize| mean(flows.iter().zip(depths).map(|(f, z)| (inverse_tangential_ratios(camera, f)[k] * z - a[k]).abs()));
    (residual(0) + residual(1)) / a.norm()
}

/// The same equation in the image: `E[|f_pla - (f o a_tan) / z|]`, pixels.
#[must_use]
pub fn flow_pixels(camera: &Intrinsics, flows: &[Vector2<f64>], depths: &[f64], a: &Vector3<f64>) -> f64 {
    mean(flows.iter().zip(depths).map(|(f, &z)| (f - tangential_flow(camera, a, z)).norm()))
}

/// Derivatives of `|f_pla - (f o a_tan) / z|` at one pixel with respect to `a_x`, `a_y` and `z`, pixels a metre (L55).
///
/// **Formula**: with the unit residual `u = (F / z - f_pla) / |F / z - f_pla|`, `F = f o a_tan`: `(u_x f_u / z, u_y f_v / z,
/// -u.F / z^2)`. The first two never exceed `f_u / z`, `f_v / z`, however small the translation.
/// **Domain**: residual not zero; there is the kink.
#[must_use]
pub fn flow_pixels_slopes(camera: &Intrinsics, flow: &Vector2<f64>, z: f64, a: &Vector3<f64>) -> Vector3<f64> {
    let predicted = tangential_flow(camera, a, z);
    let unit = (predicted - flow).normalize();
    Vector3::new(unit.x * camera.fu / z, unit.y * camera.fv / z, -unit.dot(&predicted) / z)
}

/// The same equation on each axis of its own: `E[|f_k - (f o a)_k / z|]`, pixels (L55).
#[must_use]
pub fn flow_pixels_by_axis(camera: &Intrinsics, flows: &[Vector2<f64>], depths: &[f64], a: &Vector3<f64>) -> Vector2<f64> {
    let residual = |k: usize| mean(flows.iter().zip(depths).map(|(f, &z)| (f - tangential_flow(camera, a, z))[k].abs()));
    Vector2::new(residual(0), residual(1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;

    #[test]
    fn a_signed_depth_error_shows_in_both_terms() {
        let (scene, a) = (testing::room(), Vector3::new(0.06, 0.04, -0.08));
        let flows: Vec<_> = scene.depths.iter().map(|&z| tangential_flow(&scene.camera, &a, z)).collect();
        let off: Vec<_> =
            scene.pixels.iter().zip(&scene.depths).map(|(p, z)| z * (1.02 + 0.1 * (0.05 * p.x + 0.03 * p.y).sin())).collect();
        let expected = 2.0 * (0.0629791460404 + 0.020396160715);
        assert!((printed(&scene.camera, &flows, &off, &a) - expected).abs() < 1e-10);
        for form in [printed, inverse_ratio, flow_pixels] {
            assert!(form(&scene.camera, &flows, &scene.depths, &a) < 1e-12);
            assert!(form(&scene.camera, &flows, &off, &a) > 1e-3);
        }
    }

    #[test]
    fn replacements_stay_finite_without_horizontal_motion() {
        let (camera, a) = (testing::kitti640(), Vector3::new(0.0, 0.02, -1.0));
        let flows = [Vector2::new(0.0, 0.3), Vector2::new(0.1, 0.5)];
        let depths = [20.0, 12.0];
        assert!(!printed(&camera, &flows, &depths, &a).is_finite());
        assert!(inverse_ratio(&camera, &flows, &depths, &a).is_finite());
        assert!(flow_pixels(&camera, &flows, &depths, &a).is_finite());
    }
}
