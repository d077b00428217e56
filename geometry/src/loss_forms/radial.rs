//! Agreement of axial flow, depth and radial translation (eq. `lr`).

use nalgebra::{Vector2, Vector3};

use super::mean;
use super::ratio_terms::{aggregate_term, pixel_term};
use crate::ratios::{inverse_radial_ratio, radial_ratio};

/// Eq. `lr` as printed: pixel plus aggregate term, without unit.
#[must_use]
pub fn printed(flows: &[Vector2<f64>], d: &[Vector2<f64>], depths: &[f64], a: &Vector3<f64>) -> f64 {
    printed_terms(flows, d, depths, a).iter().sum()
}

/// The two terms of [`printed`]: pixel, aggregate.
#[must_use]
pub fn printed_terms(flows: &[Vector2<f64>], d: &[Vector2<f64>], depths: &[f64], a: &Vector3<f64>) -> [f64; 2] {
    let ratios: Vec<_> = flows.iter().zip(d).map(|(f, d)| radial_ratio(f, d)).collect();
    let inverse: Vec<_> = flows.iter().zip(d).map(|(f, d)| inverse_radial_ratio(f, d)).collect();
    [pixel_term(&ratios, depths, a.z), aggregate_term(&inverse, depths, a.z)]
}

/// `E[|z/rho_z - a_z|] / |a|`.
#[must_use]
pub fn inverse_ratio(flows: &[Vector2<f64>], d: &[Vector2<f64>], depths: &[f64], a: &Vector3<f64>) -> f64 {
    let residual = |((f, d), z): ((&Vector2<f64>, &Vector2<f64>), &f64)| (inverse_radial_ratio(f, d) * z - a.z).abs();
    mean(flows.iter().zip(d).zip(depths).map(residual)) / a.norm()
}

/// The same equation in the image, along the radius: `E[|(f_axi + d a_z / (z + a_z)) . d / |d||]`, pixels.
#[must_use]
pub fn flow_pixels(flows: &[Vector2<f64>], d: &[Vector2<f64>], depths: &[f64], a: &Vector3<f64>) -> f64 {
    let residual = |((f, d), z): ((&Vector2<f64>, &Vector2<f64>), &f64)| {
        let r = d.norm();
        (f.dot(d) / r + r * a.z / (z + a.z)).abs()
    };
    mean(flows.iter().zip(d).zip(depths).map(residual))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flow::radial::radial_flow;
    use crate::testing;

    #[test]
    fn a_signed_depth_error_shows_in_both_terms() {
        let (scene, a) = (testing::room(), Vector3::new(0.06, 0.04, -0.08));
        let d: Vec<_> = scene.pixels.iter().map(|p| p - scene.camera.principal_point()).collect();
        let flows: Vec<_> =
            scene.pixels.iter().zip(&scene.depths).map(|(p, &z)| radial_flow(&scene.camera, a.z, p, z).unwrap()).collect();
        let off: Vec<_> =
            scene.pixels.iter().zip(&scene.depths).map(|(p, z)| z * (1.02 + 0.1 * (0.05 * p.x + 0.03 * p.y).sin())).collect();
        let expected = 0.0629791460404 + 0.020396160715;
        assert!((printed(&flows, &d, &off, &a) - expected).abs() < 1e-10);
        for form in [printed, inverse_ratio, flow_pixels] {
            assert!(form(&flows, &d, &scene.depths, &a) < 1e-10);
            assert!(form(&flows, &d, &off, &a) > 1e-3);
        }
    }
}
