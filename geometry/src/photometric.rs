//! Photometric error of two windows of colours (eq. `photometric_loss`), on plain numbers.
//!
//! A window is a list of colours in `[0, 1]` around one pixel, the same list of places in both images. Means, variances and the
//! covariance divide by the number of colours.

/// `C_1 = 0.01^2`: keeps the quotient of the means finite where both images are dark.
pub const C1: f64 = 1e-4;
/// `C_2 = 0.03^2`: keeps the quotient of the variances finite where both images are flat.
pub const C2: f64 = 9e-4;
/// Weight of the dissimilarity in the paper.
pub const ALPHA: f64 = 0.85;

/// Means, variances and covariance of the colours `x` and `y` of two windows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moments {
    /// Mean of `x`.
    pub mean_x: f64,
    /// Mean of `y`.
    pub mean_y: f64,
    /// Variance of `x`, divided by the number of colours.
    pub variance_x: f64,
    /// Variance of `y`, divided by the number of colours.
    pub variance_y: f64,
    /// Covariance of both, divided by the number of colours.
    pub covariance: f64,
}

impl Moments {
    /// Moments of two windows.
    ///
    /// **Panics** when the windows are empty or of different size.
    #[must_use]
    #[track_caller]
    pub fn of(x: &[f64], y: &[f64]) -> Self {
        assert!(!x.is_empty() && x.len() == y.len(), "windows of {} and {} colours: equal and not empty", x.len(), y.len());
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        let (mean_x, mean_y) = (mean(x), mean(y));
        let centred = |values: &[f64], mean: f64| values.iter().map(|v| v - mean).collect::<Vec<_>>();
        let (x, y) = (centred(x, mean_x), centred(y, mean_y));
        let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>() / a.len() as f64;
        Self { mean_x, mean_y, variance_x: product(&x, &x), variance_y: product(&y, &y), covariance: product(&x, &y) }
    }

    /// Structural similarity, in `[-1, 1]` but for rounding; 1 for equal windows.
    ///
    /// **Formula**: `S = (2 m_x m_y + c1) (2 s_xy + c2) / [(m_x^2 + m_y^2 + c1) (s_x^2 + s_y^2 + c2)]`.
    #[must_use]
    pub fn similarity(&self, c1: f64, c2: f64) -> f64 {
        let [means, covariances, squares, variances] = self.factors(c1, c2);
        means * covariances / (squares * variances)
    }

    /// The factors of the similarity: two above, two below the line.
    fn factors(&self, c1: f64, c2: f64) -> [f64; 4] {
        [
            2.0 * self.mean_x * self.mean_y + c1,
            2.0 * self.covariance + c2,
            self.mean_x * self.mean_x + self.mean_y * self.mean_y + c1,
            self.variance_x + self.variance_y + c2,
        ]
    }
}

/// Derivatives of [`Moments::similarity`] by every colour of the window `x`.
///
/// **Formula**, with the factors `A_1 A_2 / (B_1 B_2)` of the similarity and `n` colours:
/// `dS/dx_i = (2 / n) { [m_y A_2 + (y_i - m_y) A_1] / (B_1 B_2) - S [m_x / B_1 + (x_i - m_x) / B_2] }`.
///
/// **Panics** as [`Moments::of`].
#[must_use]
#[track_caller]
pub fn similarity_gradient(x: &[f64], y: &[f64], c1: f64, c2: f64) -> Vec<f64> {
    let m = Moments::of(x, y);
    let [a1, a2, b1, b2] = m.factors(c1, c2);
    let (similarity, count) = (m.similarity(c1, c2), x.len() as f64);
    let slope = |x: f64, y: f64| {
        let above = (m.mean_y * a2 + (y - m.mean_y) * a1) / (b1 * b2);
        let below = m.mean_x / b1 + (x - m.mean_x) / b2;
        2.0 / count * (above - similarity * below)
    };
    x.iter().zip(y).map(|(&x, &y)| slope(x, y)).collect()
}

/// Derivatives of the error of one channel, `alpha (1 - S) / 2 + (1 - alpha) |x_c - y_c|`, by every colour of the window `x`; `c` is
/// the place of the pixel in its window. Where the clamp of the first factor is not active; at `x_c = y_c` the second has slope 0.
///
/// **Panics** as [`Moments::of`], and when the window has no place `c`.
#[must_use]
#[track_caller]
pub fn channel_error_gradient(x: &[f64], y: &[f64], centre: usize, alpha: f64) -> Vec<f64> {
    let mut slopes = similarity_gradient(x, y, C1, C2);
    slopes.iter_mut().for_each(|slope| *slope *= -0.5 * alpha);
    let difference = x[centre] - y[centre];
    slopes[centre] += (1.0 - alpha) * if difference == 0.0 { 0.0 } else { difference.signum() };
    slopes
}

/// First factor of the loss: `(1 - S) / 2`, clamped to `[0, 1]`.
///
/// **Reading**: the similarity of two windows that hardly differ can exceed 1 by rounding; without the clamp the loss would then
/// be negative. A similarity that is NaN stays NaN.
#[must_use]
pub fn dissimilarity(similarity: f64) -> f64 {
    (0.5 * (1.0 - similarity)).clamp(0.0, 1.0)
}

/// Photometric error of one pixel from the similarity and the difference `I' - I` of each of its channels.
///
/// **Formula** (eq. `photometric_loss`): `alpha mean_c (1 - S_c) / 2 + (1 - alpha) mean_c |I'_c - I_c|`, the first factor clamped.
/// **Reading**: the 1-norm of the equation is the mean over the channels, as in the programs the paper builds on; the number of
/// channels then does not move the balance of the two terms.
///
/// **Panics** when the lists are empty or of different length.
#[must_use]
#[track_caller]
pub fn photometric_error(similarities: &[f64], differences: &[f64], alpha: f64) -> f64 {
    let channels = similarities.len();
    assert!(channels > 0 && channels == differences.len(), "{channels} similarities and {} differences", differences.len());
    let mean = |sum: f64| sum / channels as f64;
    let structure = mean(similarities.iter().map(|&s| dissimilarity(s)).sum());
    let colour = mean(differences.iter().map(|d| d.abs()).sum());
    alpha * structure + (1.0 - alpha) * colour
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn constant_windows() {
        let similarity = Moments::of(&[0.4; 9], &[0.5; 9]).similarity(C1, C2);
        assert!((similarity - 0.975615703487).abs() < 1e-12);
        assert!((photometric_error(&[similarity], &[0.1], ALPHA) - 0.025363326018).abs() < 1e-12);
    }

    #[test]
    fn opposite_patterns_have_a_negative_similarity() {
        let (x, y) = ([0.0, 1.0, 0.0, 1.0], [1.0, 0.0, 1.0, 0.0]);
        let m = Moments::of(&x, &y);
        assert_eq!((m.mean_x, m.variance_x, m.variance_y, m.covariance), (0.5, 0.25, 0.25, -0.25));
        let expected = (-0.5 + C2) / (0.5 + C2);
        assert!((m.similarity(C1, C2) - expected).abs() < 1e-15);
        assert!(similarity_gradient(&x, &y, C1, C2).iter().all(|g| g.is_finite()));
    }

    #[test]
    fn the_clamp_keeps_the_interval_and_what_is_no_number() {
        assert_eq!([dissimilarity(1.0 + 1e-15), dissimilarity(-1.0 - 1e-15), dissimilarity(0.0)], [0.0, 1.0, 0.5]);
        assert!(dissimilarity(f64::NAN).is_nan());
    }

    #[test]
    fn equal_colours_have_no_slope() {
        let window = [0.1, 0.5, 0.9];
        assert!(channel_error_gradient(&window, &window, 1, ALPHA).iter().all(|g| g.abs() < 1e-15));
        assert!((channel_error_gradient(&[0.6; 3], &[0.5; 3], 1, 0.0)[1] - 1.0).abs() < 1e-15);
    }

    #[test]
    #[should_panic(expected = "windows of 2 and 1 colours")]
    fn windows_of_different_size_are_refused() {
        let _ = Moments::of(&[0.0, 1.0], &[0.0]);
    }
}
