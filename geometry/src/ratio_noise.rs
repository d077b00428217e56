//! What flow noise does to the ratios, to first order, and how often it turns the sign of `rho_z` (L60).
//!
//! `sigma` is the standard deviation of one flow component, pixels; `z` and `t` are in one unit.

use dimode_autodiff::Scalar;

use crate::camera::Intrinsics;
use crate::ratios::radial_ratio_noise;

/// Derivative of `rho_z` with respect to the radial flow component: `r / f_r^2`, 1 / px.
///
/// With exact flow it equals `(z + t_z)^2 / (t_z^2 r)`.
#[must_use]
pub fn radial_ratio_slope(f_r: f64, r: f64) -> f64 {
    r / (f_r * f_r)
}

/// Relative standard deviation of the depth `rho_z t_z`: `sigma (z + t_z)^2 / (z |t_z| r)`; falls with the radius.
#[must_use]
pub fn radial_depth_noise(sigma: f64, z: f64, t_z: f64, r: f64) -> f64 {
    radial_ratio_noise(sigma, z, t_z, r) * (t_z / z).abs()
}

/// Relative standard deviation of the depth `rho_x t_x`: `sigma z / (f_u |t_x|)`; the same everywhere in the image.
#[must_use]
pub fn tangential_depth_noise(camera: &Intrinsics, sigma: f64, z: f64, t_x: f64) -> f64 {
    sigma * z / (camera.fu * t_x.abs())
}

/// Radius from which [`radial_depth_noise`] stays below `limit`: `sigma (z + t_z)^2 / (z |t_z| limit)`, pixels.
#[must_use]
pub fn least_radius(sigma: f64, z: f64, t_z: f64, limit: f64) -> f64 {
    radial_depth_noise(sigma, z, t_z, 1.0) / limit
}

/// Mass of the standard normal distribution above `x`: `erfc(x / sqrt 2) / 2`, with relative precision far out.
#[must_use]
pub fn normal_upper_tail(x: f64) -> f64 {
    0.5 * Scalar::erfc(x * std::f64::consts::FRAC_1_SQRT_2)
}

/// Probability that Gaussian noise turns the sign of the radial flow, and with it of `rho_z`: `Phi(-|f_r| / sigma)`.
#[must_use]
pub fn sign_flip_probability(f_r: f64, sigma: f64) -> f64 {
    normal_upper_tail(f_r.abs() / sigma)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::quadrature::GaussLegendre;
    use crate::ratios::radial_flow_component;

    #[test]
    fn documented_values() {
        let f_r = radial_flow_component(20.0, -0.8, 100.0);
        assert!((sign_flip_probability(f_r, 0.5) / 3.929873434851047e-17 - 1.0).abs() < 1e-12);
        assert!((radial_depth_noise(0.5, 20.0, -0.8, 2.0) - 5.76).abs() < 1e-13);
        assert!((least_radius(0.5, 20.0, -0.8, 0.2) - 57.6).abs() < 1e-12);
        assert!((tangential_depth_noise(&crate::scenes::kitti640(), 0.5, 20.0, 0.02) - 1.3469827586206897).abs() < 1e-14);
    }

    #[test]
    fn the_tail_is_the_integral_of_the_bell() {
        let rule = GaussLegendre::new();
        for x in [0.0, 0.3, 1.7, 5.0, 9.0, 25.0] {
            // The bell relative to its value at x; beyond a drop of e^-45 nothing counts.
            let end = (x * x + 90f64).sqrt() - x;
            let relative = rule.integral(0.0, end, 16, |s| (-s * (x + 0.5 * s)).exp());
            let expected = relative * (-0.5 * x * x).exp() / std::f64::consts::TAU.sqrt();
            assert!((normal_upper_tail(x) / expected - 1.0).abs() < 1e-12, "{x}");
        }
    }
}
