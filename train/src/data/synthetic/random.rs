//! Seeded randomness: a mixing function, a generator with the draws that worlds need, and smooth random functions.

use std::f64::consts::TAU;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Scrambles 64 bits so that neighbouring inputs give unrelated outputs (a bijection).
pub fn mix(x: u64) -> u64 {
    let mut z = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// A stream of random draws.
pub struct Draw {
    generator: ChaCha8Rng,
}

impl Draw {
    /// The stream number `stream` of a seed.
    pub fn new(seed: u64, stream: u64) -> Self {
        Self { generator: ChaCha8Rng::seed_from_u64(mix(seed) ^ mix(stream.wrapping_mul(2) + 1)) }
    }

    /// Uniform in [0, 1).
    pub fn unit(&mut self) -> f64 {
        self.generator.random::<f64>()
    }

    /// Uniform in [lo, hi).
    pub fn range(&mut self, lo: f64, hi: f64) -> f64 {
        lo + (hi - lo) * self.unit()
    }

    /// Uniform in the logarithm, in [lo, hi); both positive.
    pub fn log_range(&mut self, lo: f64, hi: f64) -> f64 {
        self.range(lo.ln(), hi.ln()).exp()
    }

    /// True with the given probability.
    pub fn chance(&mut self, probability: f64) -> bool {
        self.unit() < probability
    }

    /// A whole number in 0..n.
    pub fn index(&mut self, n: usize) -> usize {
        ((self.unit() * n as f64) as usize).min(n - 1)
    }

    /// -1 or 1.
    pub fn sign(&mut self) -> f64 {
        if self.chance(0.5) { 1.0 } else { -1.0 }
    }

    /// Two independent standard normal numbers.
    pub fn normal_pair(&mut self) -> (f64, f64) {
        let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
        let (sin, cos) = (TAU * self.unit()).sin_cos();
        (radius * cos, radius * sin)
    }
}

/// A smooth random function of a real argument: a sum of sinusoids with random phases, mean 0 and standard deviation 1 over
/// a long stretch.
pub struct Smooth {
    /// (amplitude, angular frequency, phase)
    waves: Vec<[f64; 3]>,
}

impl Smooth {
    /// `count` waves with periods drawn log-uniformly between `shortest` and `longest`.
    pub fn new(draw: &mut Draw, count: usize, shortest: f64, longest: f64) -> Self {
        let amplitude = (2.0 / count as f64).sqrt();
        let waves = (0..count)
            .map(|_| {
                let period = draw.log_range(shortest, longest);
                [amplitude, TAU / period, draw.range(0.0, TAU)]
            })
            .collect();
        Self { waves }
    }

    /// The value at `x`.
    pub fn at(&self, x: f64) -> f64 {
        self.waves.iter().map(|[a, w, p]| a * (w * x + p).sin()).sum()
    }

    /// The value at `x` squashed into (-1, 1).
    pub fn bounded(&self, x: f64) -> f64 {
        self.at(x).tanh()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smooth_has_unit_variance_and_small_steps() {
        let smooth = Smooth::new(&mut Draw::new(3, 0), 6, 10.0, 40.0);
        let n = 20_000;
        let variance = (0..n).map(|i| smooth.at(i as f64).powi(2)).sum::<f64>() / n as f64;
        assert!((variance - 1.0).abs() < 0.05, "{variance}");
        assert!((0..n).all(|i| (smooth.at(i as f64 + 0.1) - smooth.at(i as f64)).abs() < 0.3));
    }

    #[test]
    fn draws_stay_in_range_and_streams_differ() {
        let (mut a, mut b) = (Draw::new(1, 0), Draw::new(1, 1));
        assert_ne!(a.unit(), b.unit());
        for _ in 0..1000 {
            assert!((2.0..3.0).contains(&a.range(2.0, 3.0)));
            assert!((0.1..10.0).contains(&a.log_range(0.1, 10.0)));
            assert!(a.index(3) < 3);
        }
    }
}
