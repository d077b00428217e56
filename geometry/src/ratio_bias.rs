//! Means and medians of ratios of a noisy flow, by deterministic quadrature (L57, L58).
//!
//! The flow component is `f + n` with Gaussian noise `n` of standard deviation `sigma`. The depth that it implies, divided by the
//! true one, is `a = f / (f + n)`. Its mean does not exist: the density of `f + n` is positive at 0. With the noise cut off at
//! [`CUT`] standard deviations (and renormalised) everything below is finite as long as the pole stays outside.

use std::sync::LazyLock;

use crate::quadrature::GaussLegendre;

/// Where truncated noise ends, in standard deviations.
pub const CUT: f64 = 3.0;
/// From this many standard deviations on the untruncated density is below rounding.
const FAR: f64 = 14.0;
/// Pieces of the truncated interval. A pole half a standard deviation outside leaves errors of 1e-20.
const PIECES: usize = 8;
/// Pieces of each part of the logarithmic axis.
const LOG_PIECES: usize = 96;

static RULE: LazyLock<GaussLegendre> = LazyLock::new(GaussLegendre::new);

fn bell(n: f64, sigma: f64) -> f64 {
    (-0.5 * (n / sigma).powi(2)).exp() / (sigma * std::f64::consts::TAU.sqrt())
}

/// `E[g(n)]` over Gaussian noise truncated at [`CUT`] standard deviations.
///
/// **Domain**: `g` smooth within the truncation.
#[must_use]
pub fn truncated_mean(sigma: f64, g: impl Fn(f64) -> f64) -> f64 {
    let end = CUT * sigma;
    let mass = RULE.integral(-end, end, PIECES, |n| bell(n, sigma));
    RULE.integral(-end, end, PIECES, |n| g(n) * bell(n, sigma)) / mass
}

/// Variance of Gaussian noise truncated at [`CUT`] standard deviations: 0.9733 `sigma^2`.
#[must_use]
pub fn truncated_variance(sigma: f64) -> f64 {
    truncated_mean(sigma, |n| n * n)
}

/// `E[f / (f + n)]`, the mean of the implied depth over the true one, truncated noise.
///
/// **Domain**: `|f| > 3 sigma`.
#[must_use]
pub fn mean_ratio(f: f64, sigma: f64) -> f64 {
    truncated_mean(sigma, |n| f / (f + n))
}

/// [`mean_ratio`] to second order in the noise: `1 + sigma^2 / f^2`.
#[must_use]
pub fn mean_ratio_second_order(f: f64, sigma: f64) -> f64 {
    1.0 + (sigma / f).powi(2)
}

/// `E[|f / (f + n) - 1|]` of untruncated noise, over `|f + n| >= cut_off` pixels: grows without bound as the cut-off shrinks.
///
/// Integrated over `s = ln |f + n|`, where the pole is a plain exponential, and cut at the kink `n = 0`.
/// **Domain**: `0 < cut_off < |f|`.
#[must_use]
pub fn mean_error_beyond(f: f64, sigma: f64, cut_off: f64) -> f64 {
    let f = f.abs();
    let [start, kink, end] = [cut_off, f, f + FAR * sigma].map(f64::ln);
    let right = |s: f64| (s.exp() - f).abs() * bell(s.exp() - f, sigma);
    let left = |s: f64| (s.exp() + f) * bell(s.exp() + f, sigma);
    let parts = [RULE.integral(start, kink, LOG_PIECES, right), RULE.integral(kink, end, LOG_PIECES, right)];
    parts[0] + parts[1] + RULE.integral(start, end, LOG_PIECES, left)
}

/// What [`mean_error_beyond`] gains whenever the cut-off shrinks by the factor `e`, in the limit: `2 |f|` times the density of
/// `f + n` at 0.
#[must_use]
pub fn mean_error_growth(f: f64, sigma: f64) -> f64 {
    2.0 * f.abs() * bell(f, sigma)
}

/// The noise at which the weighted density of the truncated noise is halved: `int_-c^n w(n) phi = int_n^c w(n) phi`.
///
/// By bisection to rounding. **Domain**: `weight` positive and smooth within the truncation.
#[must_use]
pub fn weighted_median_noise(sigma: f64, weight: impl Fn(f64) -> f64) -> f64 {
    let end = CUT * sigma;
    let mass = |a: f64, b: f64| RULE.integral(a, b, PIECES, |n| weight(n) * bell(n, sigma));
    let (mut lo, mut hi) = (-end, end);
    for _ in 0..60 {
        let middle = 0.5 * (lo + hi);
        if mass(-end, middle) < mass(middle, end) { lo = middle } else { hi = middle }
    }
    0.5 * (lo + hi)
}

/// To second order, how far the `a`-weighted median of `a` lies above 1, and the `1/a`-weighted one below it.
///
/// **Formula**: `(1 - e^(-9/2)) (sigma / f)^2`.
///
/// The weight tilts the density by `n / f`, whose half-means `sigma (1 - e^(-9/2)) / sqrt(2 pi)` the median balances with the
/// density `1 / (sigma sqrt(2 pi))` at its place.
#[must_use]
pub fn median_offset_second_order(f: f64, sigma: f64) -> f64 {
    (1.0 - (-0.5 * CUT * CUT).exp()) * (sigma / f).powi(2)
}

/// Which relative error a pixel term averages; `a` is the depth that the flow implies, `z` the predicted one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PixelError {
    /// `|a - z| / z`, as printed.
    OverPrediction,
    /// `|z - a| / a`.
    OverRatio,
    /// `|1/z - 1/a|`.
    InverseDepth,
}

impl PixelError {
    /// The error at one pixel; depths over the true one.
    #[must_use]
    pub fn at(self, a: f64, z: f64) -> f64 {
        match self {
            Self::OverPrediction => (a - z).abs() / z,
            Self::OverRatio => (z - a).abs() / a,
            Self::InverseDepth => (1.0 / z - 1.0 / a).abs(),
        }
    }

    /// The constant prediction, over the true depth, that makes the expected error least under truncated noise.
    ///
    /// Setting the derivative to zero balances `a` (printed form), `1/a`, or nothing on both sides: a median of `a` so weighted.
    /// **Domain**: `f > 3 sigma`.
    #[must_use]
    pub fn minimiser(self, f: f64, sigma: f64) -> f64 {
        let noise = match self {
            Self::OverPrediction => weighted_median_noise(sigma, |n| f / (f + n)),
            Self::OverRatio => weighted_median_noise(sigma, |n| (f + n) / f),
            Self::InverseDepth => weighted_median_noise(sigma, |_| 1.0),
        };
        f / (f + noise)
    }
}

/// Bias of the radial translation that one noisy pixel recovers, `E[z / rho_z] - t_z`, truncated noise, in the unit of `z` (L58).
///
/// **Domain**: `r + f_r > 3 sigma`: the noisy flow must not end on the principal point.
#[must_use]
pub fn radial_recovery_bias(sigma: f64, z: f64, t_z: f64, r: f64) -> f64 {
    let f_r = crate::ratios::radial_flow_component(z, t_z, r);
    // z / rho_z - t_z with the common part taken out: no cancellation where the bias is small.
    let change = |n: f64| -z * r * n / ((r + f_r + n) * (r + f_r));
    truncated_mean(sigma, change)
}

/// The same to second order: `z v / r^2 ((z + t_z) / z)^3` with the noise's variance `v`; positive for either sign of `t_z`.
#[must_use]
pub fn radial_recovery_bias_second_order(variance: f64, z: f64, t_z: f64, r: f64) -> f64 {
    z * variance / (r * r) * ((z + t_z) / z).powi(3)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ratios::{inverse_radial_ratio_of_component, radial_flow_component};

    fn close(a: f64, b: f64, relative: f64) {
        assert!((a / b - 1.0).abs() < relative, "{a} {b}");
    }

    #[test]
    fn documented_values() {
        close(mean_ratio(2.0, 0.5), 1.0755497746672262, 1e-12);
        close(PixelError::OverPrediction.minimiser(2.0, 0.5), 1.0751718880526309, 1e-12);
        close(PixelError::OverRatio.minimiser(4.0, 0.5), 0.9848603591409786, 1e-12);
        close(mean_error_beyond(0.5, 0.5, 1e-6), 6.369255337298665, 1e-11);
        close(mean_error_beyond(2.0, 0.5, 1e-2), 0.23786185247650074, 1e-11);
        close(radial_recovery_bias(0.5, 20.0, -0.8, 2.0), 1.308116372202476, 1e-11);
    }

    #[test]
    fn the_rearranged_bias_is_the_mean_of_what_is_recovered() {
        let f_r = radial_flow_component(20.0, 0.8, 5.0);
        let plain = truncated_mean(0.5, |n| 20.0 * inverse_radial_ratio_of_component(f_r + n, 5.0)) - 0.8;
        close(radial_recovery_bias(0.5, 20.0, 0.8, 5.0), plain, 1e-11);
    }

    #[test]
    fn truncation_takes_its_part_of_the_variance() {
        // 1 - 2 c phi(c) / (2 Phi(c) - 1) at c = 3.
        let (c, phi) = (CUT, bell(CUT, 1.0));
        let mass = 1.0 - 2.0 * crate::ratio_noise::normal_upper_tail(c);
        close(truncated_variance(0.5), 0.25 * (1.0 - 2.0 * c * phi / mass), 1e-13);
    }
}
