//! Reproducible random numbers that depend on a seed and an index alone: no state, no order of drawing. What a seed gives is part
//! of every run's bits and never changes.

use crate::{Scalar, Shape, Tensor};

/// Spacing of the states of SplitMix64: 2^64 divided by the golden ratio.
const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;
/// Keeps seed 0 away from state 0.
const OFFSET: u64 = 0x5851_f42d_4c95_7f2d;

/// Numbers uniform in `[lo, hi)`, the same for the same seed and shape on every machine.
///
/// **Formula**: entry `i`, in the order of the buffer, is `lo + (hi - lo) u` with `u` the upper 53 bits of the `i`-th output of
/// SplitMix64 divided by 2^53; the generator starts at the seed, multiplied and offset by constants. All of it in `f64`, rounded
/// to `T` at the end: in `f32` the largest numbers may round up to `hi`.
///
/// ```
/// use dimode_autodiff::{Shape, rng};
/// let x = rng::uniform::<f64>(1, Shape::new(2, 3, 4, 5), -1.0, 1.0);
/// assert!(x.data().iter().all(|v| (-1.0..1.0).contains(v)));
/// assert_eq!(x, rng::uniform(1, Shape::new(2, 3, 4, 5), -1.0, 1.0));
/// ```
///
/// **References**: Steele, Lea, Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014.
pub fn uniform<T: Scalar>(seed: u64, shape: Shape, lo: f64, hi: f64) -> Tensor<T> {
    Tensor::from_vec(shape, (0..shape.len()).map(|i| uniform_at(seed, i as u64, lo, hi)).collect())
}

/// Entry `index` of [`uniform`], for loops that need no tensor of them.
///
/// ```
/// use dimode_autodiff::{Shape, rng};
/// let x = rng::uniform::<f32>(1, Shape::new(2, 3, 4, 5), -1.0, 1.0);
/// assert_eq!(x.data()[7], rng::uniform_at(1, 7, -1.0, 1.0));
/// ```
#[must_use]
pub fn uniform_at<T: Scalar>(seed: u64, index: u64, lo: f64, hi: f64) -> T {
    let start = seed.wrapping_mul(GOLDEN) ^ OFFSET;
    T::from_f64(lo + (hi - lo) * unit(start, index))
}

/// Output `index` (from 0) of the SplitMix64 sequence that starts at `state`.
#[must_use]
pub fn splitmix64(state: u64, index: u64) -> u64 {
    let mut z = state.wrapping_add(index.wrapping_add(1).wrapping_mul(GOLDEN));
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Number `index` of a sequence that is uniform in `[0, 1)`.
pub(crate) fn unit(state: u64, index: u64) -> f64 {
    (splitmix64(state, index) >> 11) as f64 / (1u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn splitmix_matches_published_values() {
        // First outputs of the reference generator for seed 1234567.
        assert_eq!(splitmix64(1_234_567, 0), 6_457_827_717_110_365_317);
        assert_eq!(splitmix64(1_234_567, 1), 3_203_168_211_198_807_973);
    }

    #[test]
    fn a_seed_gives_the_same_numbers_for_ever() {
        let shape = Shape::new(1, 1, 1, 3);
        let pinned = [
            (0, [0.7286465750620634, 0.025776259288379233, 0.9480811054092159]),
            (1, [0.11715404803910068, 0.824121383510308, 0.6116088336171334]),
            ((1 << 63) + 5, [0.8350945720842605, 0.4462778487018043, 0.5522113681936769]),
        ];
        for (seed, expected) in pinned {
            assert_eq!(uniform::<f64>(seed, shape, 0.0, 1.0).data(), expected, "seed {seed}");
        }
        let single = uniform::<f32>(1, shape, -3.0, 5.0);
        let expected = pinned[1].1.map(|u| (-3.0 + 8.0 * u) as f32);
        assert_eq!(single.data(), expected);
    }

    #[test]
    fn the_numbers_are_uniform() {
        let count = 100_000;
        let x = uniform::<f64>(7, Shape::new(1, 1, 1, count), 0.0, 1.0);
        let mean = |f: fn(f64) -> f64| x.data().iter().map(|&v| f(v)).sum::<f64>() / count as f64;
        // Four standard deviations of a mean over that many numbers are below 0.004.
        assert!((mean(|v| v) - 0.5).abs() < 0.004);
        assert!((mean(|v| v * v) - 1.0 / 3.0).abs() < 0.004);
    }
}
