//! The two terms that eqs. `lt` and `lr` are made of, for one axis.

use super::mean;

/// Pixel term `E[|rho a - z| / z]` of eqs. `lt`, `lr`, without unit.
///
/// Not finite where a ratio is not.
#[must_use]
pub fn pixel_term(ratios: &[f64], depths: &[f64], a: f64) -> f64 {
    mean(ratios.iter().zip(depths).map(|(rho, z)| (rho * a - z).abs() / z))
}

/// Aggregate term `|(E[z / rho] - a) / a|` of eqs. `lt`, `lr`, from inverse ratios, without unit.
///
/// Not finite at `a = 0`.
#[must_use]
pub fn aggregate_term(inverse_ratios: &[f64], depths: &[f64], a: f64) -> f64 {
    let recovered = mean(inverse_ratios.iter().zip(depths).map(|(i, z)| i * z));
    ((recovered - a) / a).abs()
}

/// Aggregate term of flows with a mean error: `|m| / |a|`, `m = E[z n / f_k]` for the flow error `n` in pixels (L55).
///
/// As the error does not shrink with the translation, this has no bound.
#[must_use]
pub fn aggregate_term_of_noise(noise: &[f64], depths: &[f64], focal: f64, a: f64) -> f64 {
    (mean(noise.iter().zip(depths).map(|(n, z)| z * n / focal)) / a).abs()
}

/// One pixel of the pixel term, `|rho a - z| / z`, for the depth `scaled_ratio = rho a` that flow and translation imply.
#[must_use]
pub fn pixel_term_at(scaled_ratio: f64, z: f64) -> f64 {
    (scaled_ratio - z).abs() / z
}

/// Derivative of [`pixel_term_at`] with respect to the predicted depth `z`, at a fixed ratio, 1 / m (L59).
///
/// **Formula**: `-sign(rho a - z) rho a / z^2`. Free of the pixel's place, but about `1/z` in size, without bound for too small
/// predictions and vanishing for too large ones.
/// **Domain**: `rho a != z`; there the term has its kink.
#[must_use]
pub fn pixel_term_slope(scaled_ratio: f64, z: f64) -> f64 {
    -(scaled_ratio - z).signum() * scaled_ratio / (z * z)
}

/// The same with respect to `log z`: `-sign(rho a - z) rho a / z`, about 1 in size near `rho a = z` at every depth (L59).
#[must_use]
pub fn pixel_term_log_slope(scaled_ratio: f64, z: f64) -> f64 {
    -(scaled_ratio - z).signum() * scaled_ratio / z
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pixel_term_is_the_mean_of_its_pixels() {
        let (ratios, depths) = ([2.0, -3.0, 5.0], [1.0, 4.0, 0.5]);
        let single = ratios.iter().zip(&depths).map(|(rho, &z)| pixel_term_at(rho * 0.7, z)).sum::<f64>() / 3.0;
        assert!((pixel_term(&ratios, &depths, 0.7) - single).abs() < 1e-15);
    }

    #[test]
    fn documented_slopes_at_twenty_metres() {
        let expected = [(10.0, -0.2, -2.0), (18.0, -0.0617283950617, -1.11111111111), (40.0, 0.0125, 0.5)];
        for (z, slope, log_slope) in expected {
            assert!((pixel_term_slope(20.0, z) - slope).abs() < 1e-11);
            assert!((pixel_term_log_slope(20.0, z) - log_slope).abs() < 1e-11);
        }
    }

    #[test]
    fn noise_over_the_translation() {
        let (noise, depths, inverse) = ([0.3, -0.1], [10.0, 20.0], [(37.0 + 0.3) / 370.0, (18.5 - 0.1) / 370.0]);
        // Exact flows of a = 1 at these depths, plus the noise.
        assert!((aggregate_term(&inverse, &depths, 1.0) - aggregate_term_of_noise(&noise, &depths, 370.0, 1.0)).abs() < 1e-15);
    }
}
