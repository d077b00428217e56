//! The loops of batch and instance normalisation, compiled for every instruction set.
//!
//! Sums run in 32 lanes of `T` over blocks of 2048 elements and are flushed to `f64` in a fixed order.

use pulp::{Arch, Simd, WithSimd};

use crate::Scalar;
use crate::activation::Activate;

/// Independent partial sums of a block.
const LANES: usize = 32;
/// Elements summed in `T` before the lanes are flushed to `f64`.
const BLOCK: usize = 64 * LANES;

/// Sum of the lanes: halves are added to each other until one number is left.
#[inline(always)]
fn flush<T: Scalar>(lanes: &[T; LANES]) -> f64 {
    let mut sums = lanes.map(T::to_f64);
    let mut half = LANES / 2;
    while half > 0 {
        for i in 0..half {
            sums[i] += sums[i + half];
        }
        half /= 2;
    }
    sums[0]
}

/// Sum of `(x - centre)`, or of its square.
struct Deviations<'a, T> {
    x: &'a [T],
    centre: T,
    squared: bool,
}

impl<T: Scalar> Deviations<'_, T> {
    #[inline(always)]
    fn sum(&self, f: impl Fn(T) -> T) -> f64 {
        let mut total = 0.0;
        for block in self.x.chunks(BLOCK) {
            let mut lanes = [T::ZERO; LANES];
            let groups = block.chunks_exact(LANES);
            let rest = groups.remainder();
            for group in groups {
                for l in 0..LANES {
                    lanes[l] += f(group[l] - self.centre);
                }
            }
            for (lane, &v) in lanes.iter_mut().zip(rest) {
                *lane += f(v - self.centre);
            }
            total += flush(&lanes);
        }
        total
    }
}

impl<T: Scalar> WithSimd for Deviations<'_, T> {
    type Output = f64;
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> f64 {
        if self.squared { self.sum(|d| d * d) } else { self.sum(|d| d) }
    }
}

/// Sum of a slice.
pub(crate) fn sum<T: Scalar>(x: &[T]) -> f64 {
    Arch::new().dispatch(Deviations { x, centre: T::ZERO, squared: false })
}

/// Mean and biased variance of a sequence of equally long slices.
pub(crate) fn moments<'a, T: Scalar>(planes: impl Iterator<Item = &'a [T]> + Clone) -> (f64, f64) {
    let mut count = 0;
    let mut total = 0.0;
    for x in planes.clone() {
        count += x.len();
        total += sum(x);
    }
    let mean = total / count as f64;
    let centre = T::from_f64(mean);
    let squares: f64 = planes.map(|x| Arch::new().dispatch(Deviations { x, centre, squared: true })).sum();
    // What rounding the centre to T has added to the squares is taken off again.
    let rounding = mean - centre.to_f64();
    (mean, (squares / count as f64 - rounding * rounding).max(0.0))
}

/// `y = activation((x - mean) scale + shift)`, with `skip` added before the activation.
pub(crate) struct Normalise<'a, T, A> {
    pub(crate) x: &'a [T],
    pub(crate) skip: Option<&'a [T]>,
    pub(crate) y: &'a mut [T],
    pub(crate) mean: T,
    pub(crate) scale: T,
    pub(crate) shift: T,
    pub(crate) activation: A,
}

impl<T: Scalar, A: Activate> Normalise<'_, T, A> {
    /// Runs the loop with the best instructions at hand.
    pub(crate) fn run(self) {
        Arch::new().dispatch(self);
    }
}

impl<T: Scalar, A: Activate> WithSimd for Normalise<'_, T, A> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { x, skip, y, mean, scale, shift, activation } = self;
        let x = &x[..y.len()];
        match skip {
            None => {
                for i in 0..y.len() {
                    y[i] = activation.of((x[i] - mean) * scale + shift);
                }
            }
            Some(skip) => {
                let skip = &skip[..y.len()];
                for i in 0..y.len() {
                    y[i] = activation.of((x[i] - mean) * scale + shift + skip[i]);
                }
            }
        }
    }
}

/// Writes the gradient `g` behind the activation, and sums it and its products with `x - centre`.
pub(crate) struct PassBack<'a, T, A> {
    pub(crate) g: &'a [T],
    pub(crate) x: &'a [T],
    /// The output, whose slope the activation knows.
    pub(crate) y: &'a [T],
    pub(crate) centre: T,
    pub(crate) activation: A,
    pub(crate) out: &'a mut [T],
}

impl<T: Scalar, A: Activate> PassBack<'_, T, A> {
    /// Runs the loop with the best instructions at hand: both sums.
    pub(crate) fn run(self) -> (f64, f64) {
        Arch::new().dispatch(self)
    }
}

impl<T: Scalar, A: Activate> WithSimd for PassBack<'_, T, A> {
    type Output = (f64, f64);
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> (f64, f64) {
        let Self { g, x, y, centre, activation, out } = self;
        let (mut total, mut moment) = (0.0, 0.0);
        for ((g, x), (y, out)) in g.chunks(BLOCK).zip(x.chunks(BLOCK)).zip(y.chunks(BLOCK).zip(out.chunks_mut(BLOCK))) {
            let (mut lanes, mut products) = ([T::ZERO; LANES], [T::ZERO; LANES]);
            let whole = out.len() / LANES * LANES;
            let mut at = 0;
            while at < whole {
                let (g, x, y, out) = (&g[at..][..LANES], &x[at..][..LANES], &y[at..][..LANES], &mut out[at..][..LANES]);
                for l in 0..LANES {
                    let passed = activation.back(y[l], g[l]);
                    out[l] = passed;
                    lanes[l] += passed;
                    products[l] += passed * (x[l] - centre);
                }
                at += LANES;
            }
            for i in whole..out.len() {
                let passed = activation.back(y[i], g[i]);
                out[i] = passed;
                lanes[i - whole] += passed;
                products[i - whole] += passed * (x[i] - centre);
            }
            total += flush(&lanes);
            moment += flush(&products);
        }
        (total, moment)
    }
}

/// `g <- (g - offset - (x - mean) slope) scale`.
pub(crate) struct Denormalise<'a, T> {
    pub(crate) g: &'a mut [T],
    pub(crate) x: &'a [T],
    pub(crate) mean: T,
    pub(crate) offset: T,
    pub(crate) slope: T,
    pub(crate) scale: T,
}

impl<T: Scalar> Denormalise<'_, T> {
    /// Runs the loop with the best instructions at hand.
    pub(crate) fn run(self) {
        Arch::new().dispatch(self);
    }
}

impl<T: Scalar> WithSimd for Denormalise<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { g, x, mean, offset, slope, scale } = self;
        let x = &x[..g.len()];
        for i in 0..g.len() {
            g[i] = (g[i] - offset - (x[i] - mean) * slope) * scale;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::activation::{Identity, Relu};

    fn numbers(len: usize) -> (Vec<f64>, Vec<f64>) {
        let x = (0..len).map(|i| ((i * 37 % 101) as f64) / 7.0 - 5.0).collect();
        let y = (0..len).map(|i| ((i * 53 % 97) as f64) / 9.0 - 4.0).collect();
        (x, y)
    }

    #[test]
    fn sums_agree_with_a_plain_loop_on_every_remainder() {
        for len in [1, 15, 31, 32, 33, 2047, 2048, 2089, 5000] {
            let (x, g) = numbers(len);
            let mut out = vec![0.0; len];
            let (total, moment) = PassBack { g: &g, x: &x, y: &x, centre: 0.5, activation: Relu, out: &mut out }.run();
            let passed: Vec<f64> = x.iter().zip(&g).map(|(x, g)| if *x > 0.0 { *g } else { 0.0 }).collect();
            let expected: f64 = passed.iter().zip(&x).map(|(a, b)| a * (b - 0.5)).sum();
            assert_eq!(out, passed);
            assert!((total - passed.iter().sum::<f64>()).abs() <= 1e-9);
            assert!((moment - expected).abs() <= 1e-9);
            let mean = x.iter().sum::<f64>() / len as f64;
            let variance = x.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / len as f64;
            let found = moments([&x[..]].into_iter());
            assert!((found.0 - mean).abs() <= 1e-12 && (found.1 - variance).abs() <= 1e-11, "{len}: {found:?}");
        }
    }

    #[test]
    fn normalising_adds_the_skip_before_the_activation() {
        let mut y = [0.0; 2];
        let (x, skip) = ([3.0, 5.0], [-10.0, 1.0]);
        Normalise { x: &x, skip: Some(&skip), y: &mut y, mean: 1.0, scale: 2.0, shift: 0.5, activation: Relu }.run();
        assert_eq!(y, [0.0, 9.5]);
        Normalise { x: &x, skip: None, y: &mut y, mean: 1.0, scale: 2.0, shift: 0.5, activation: Identity }.run();
        assert_eq!(y, [4.5, 8.5]);
    }
}
