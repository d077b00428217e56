//! Start values of parameters, from an explicit seed.

use dimode_autodiff::rng::splitmix64;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::hash::fnv1a64;

/// Distribution of the start values of one tensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Init {
    /// Every element the same.
    Constant(f64),
    /// Uniform in `[-bound, bound)`.
    Uniform {
        /// Largest magnitude.
        bound: f64,
    },
    /// Normal with mean 0.
    Normal {
        /// Standard deviation.
        deviation: f64,
    },
}

impl Init {
    /// The default of convolution and linear layers: uniform in `+-1/sqrt(fan_in)`, for weights
    /// and biases alike.
    pub fn fan_in(fan_in: usize) -> Self {
        Self::Uniform { bound: 1.0 / (fan_in.max(1) as f64).sqrt() }
    }

    /// Uniform with deviation `sqrt(1.5 / fan_in)`: keeps the spread of activations through layers of convolution and ELU,
    /// where [`Init::fan_in`] shrinks it by 0.6 a layer.
    pub fn elu(fan_in: usize) -> Self {
        Self::Uniform { bound: (4.5 / fan_in.max(1) as f64).sqrt() }
    }

    /// Kaiming normal with fan-out and the gain of the ReLU: deviation `sqrt(2 / fan_out)`, where
    /// `fan_out` is the number of output channels times the kernel area.
    pub fn kaiming_fan_out(fan_out: usize) -> Self {
        Self::Normal { deviation: (2.0 / fan_out.max(1) as f64).sqrt() }
    }
}

/// Draws `len` values. The stream depends on `seed` and `path` only.
pub fn draw(init: &Init, seed: u64, path: &str, len: usize) -> Vec<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(splitmix64(seed ^ fnv1a64(path), 0));
    match *init {
        Init::Constant(value) => vec![value; len],
        Init::Uniform { bound } => (0..len).map(|_| bound * (2.0 * unit(&mut rng) - 1.0)).collect(),
        Init::Normal { deviation } => (0..len).map(|_| deviation * normal(&mut rng)).collect(),
    }
}

/// Uniform in [0, 1) on a grid of 2^-53.
fn unit(rng: &mut ChaCha8Rng) -> f64 {
    (rng.next_u64() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
}

/// Standard normal by the cosine half of Box and Muller; the argument of the logarithm is in (0, 1].
fn normal(rng: &mut ChaCha8Rng) -> f64 {
    let radius = (-2.0 * (1.0 - unit(rng)).ln()).sqrt();
    radius * (std::f64::consts::TAU * unit(rng)).cos()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn moments(values: &[f64]) -> (f64, f64) {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n;
        (mean, variance.sqrt())
    }

    #[test]
    fn uniform_has_its_bound_and_deviation() {
        let values = draw(&Init::fan_in(25), 1, "f:w", 40_000);
        let (mean, deviation) = moments(&values);
        assert!(values.iter().all(|v| v.abs() <= 0.2));
        assert!(values.iter().any(|v| v.abs() > 0.199));
        assert!(mean.abs() < 0.003, "mean {mean}");
        assert!((deviation - 0.2 / 3f64.sqrt()).abs() < 0.002, "{deviation}");
    }

    #[test]
    fn kaiming_has_its_deviation_and_tails() {
        let values = draw(&Init::kaiming_fan_out(8 * 9), 1, "f:w", 40_000);
        let expected = (2.0f64 / 72.0).sqrt();
        let (mean, deviation) = moments(&values);
        assert!(mean.abs() < 0.02 * expected, "mean {mean}");
        assert!((deviation / expected - 1.0).abs() < 0.02, "{deviation}");
        let beyond = values.iter().filter(|v| v.abs() > 2.0 * expected).count();
        assert!((1600..2100).contains(&beyond), "{beyond} beyond two sigma");
    }

    #[test]
    fn seed_and_path_both_matter_and_nothing_else() {
        let init = Init::Uniform { bound: 1.0 };
        let base = draw(&init, 1, "f:a", 4);
        assert_eq!(base, draw(&init, 1, "f:a", 4));
        assert_eq!(base[..], draw(&init, 1, "f:a", 9)[..4]);
        assert_ne!(base, draw(&init, 2, "f:a", 4));
        assert_ne!(base, draw(&init, 1, "f:b", 4));
    }
}
