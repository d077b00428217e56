//! Elementwise loops over slices, parallel in fixed chunks, compiled for every instruction set.

use pulp::{Arch, Simd, WithSimd};

use crate::Scalar;
use crate::par;

#[track_caller]
fn assert_lengths(out: usize, others: &[usize]) {
    assert!(others.iter().all(|&len| len == out), "kernel: slices of {out} and {others:?} elements");
}

/// A loop of `out[i] <- f(out[i], x[0][i], x[1][i], ..)` that the compiler turns into vector code of the processor at hand: results
/// are the same bits on all of them, since nothing is fused and no order changes.
struct Each<'a, T, F, const N: usize> {
    out: &'a mut [T],
    x: [&'a [T]; N],
    f: F,
}

impl<T: Scalar, F: Fn(T, [T; N]) -> T, const N: usize> WithSimd for Each<'_, T, F, N> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { out, x, f } = self;
        let x = x.map(|x| &x[..out.len()]);
        for i in 0..out.len() {
            out[i] = f(out[i], x.map(|x| x[i]));
        }
    }
}

/// Runs [`Each`] in parallel.
fn each<T: Scalar, const N: usize>(out: &mut [T], x: [&[T]; N], f: impl Fn(T, [T; N]) -> T + Sync + Send) {
    par::for_each_chunk(out, par::CHUNK, |i, out| {
        let x = x.map(|x| &x[i * par::CHUNK..][..out.len()]);
        Arch::new().dispatch(Each { out, x, f: &f });
    });
}

/// `out[i] = f(out[i])`.
pub fn update<T: Scalar>(out: &mut [T], f: impl Fn(T) -> T + Sync + Send) {
    each(out, [], |old, []| f(old));
}

/// `out[i] = f(x[i])`.
///
/// # Panics
/// When the lengths differ (all functions of this module).
#[track_caller]
pub fn map<T: Scalar>(out: &mut [T], x: &[T], f: impl Fn(T) -> T + Sync + Send) {
    assert_lengths(out.len(), &[x.len()]);
    each(out, [x], |_, [x]| f(x));
}

/// `out[i] += f(x[i])`.
#[track_caller]
pub fn map_add<T: Scalar>(out: &mut [T], x: &[T], f: impl Fn(T) -> T + Sync + Send) {
    assert_lengths(out.len(), &[x.len()]);
    each(out, [x], |sum, [x]| sum + f(x));
}

/// `out[i] = f(x[i], y[i])`.
#[track_caller]
pub fn zip<T: Scalar>(out: &mut [T], x: &[T], y: &[T], f: impl Fn(T, T) -> T + Sync + Send) {
    assert_lengths(out.len(), &[x.len(), y.len()]);
    each(out, [x, y], |_, [x, y]| f(x, y));
}

/// `out[i] = f(x[i], y[i], z[i])`.
#[track_caller]
pub fn zip3<T: Scalar>(out: &mut [T], x: &[T], y: &[T], z: &[T], f: impl Fn(T, T, T) -> T + Sync + Send) {
    assert_lengths(out.len(), &[x.len(), y.len(), z.len()]);
    each(out, [x, y, z], |_, [x, y, z]| f(x, y, z));
}

/// `sum of x[i]²`, squared and summed in `f64`.
pub fn sum_of_squares<T: Scalar>(x: &[T]) -> f64 {
    par::sum(x.len(), |range| Arch::new().dispatch(Squares(&x[range])))
}

struct Squares<'a, T>(&'a [T]);

impl<T: Scalar> WithSimd for Squares<'_, T> {
    type Output = f64;
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> f64 {
        // Registers of their own: one array of all lanes stays in memory, which took more than three times as long.
        let mut lanes = [[0.0; 8]; 4];
        let (groups, rest) = self.0.as_chunks::<32>();
        for group in groups {
            let [a, b, c, d] = &mut lanes;
            for (k, lanes) in [a, b, c, d].into_iter().enumerate() {
                for l in 0..8 {
                    let x = group[8 * k + l].to_f64();
                    lanes[l] += x * x;
                }
            }
        }
        let lanes = lanes.as_flattened_mut();
        for (lane, x) in lanes.iter_mut().zip(rest) {
            *lane += x.to_f64() * x.to_f64();
        }
        lanes.iter().sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn squares_are_summed_beyond_the_range_of_single_precision() {
        for len in [0, 1, 31, 32, 33, 100, par::CHUNK + 5] {
            let x: Vec<f32> = (0..len).map(|i| 1e25 * (i as f32 + 1.0)).collect();
            let want: f64 = x.iter().map(|&x| f64::from(x) * f64::from(x)).sum();
            assert!((sum_of_squares(&x) - want).abs() <= 1e-12 * want, "{len}");
        }
    }
}
