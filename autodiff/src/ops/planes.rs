//! Walking tensors plane by plane, row helpers and sums shared by the spatial and normalisation ops.
//!
//! Every task owns a fixed number of whole planes, chosen from the plane size alone, so the result does not depend on
//! the number of threads. Sums run in sixteen lanes of `T` over blocks of 1024 elements and are flushed to `f64`.

use crate::{Scalar, Shape, par};

/// Elements that one task should cover at least; a plane larger than this is a task of its own.
const TASK_ELEMENTS: usize = 8192;
/// Independent partial sums of a block.
const LANES: usize = 16;
/// Elements summed in `T` before the lanes are flushed to `f64`.
const BLOCK: usize = 64 * LANES;

/// Calls `f(index, plane)` for every plane of `out`, in parallel over fixed groups of planes.
pub(crate) fn for_each_plane<T, F>(out: &mut [T], plane: usize, f: F)
where
    T: Scalar,
    F: Fn(usize, &mut [T]) + Sync + Send,
{
    let group = (TASK_ELEMENTS / plane).max(1);
    par::for_each_chunk(out, group * plane, |chunk, slice| {
        for (k, one) in slice.chunks_exact_mut(plane).enumerate() {
            f(chunk * group + k, one);
        }
    });
}

/// Sum of `f(x)` over the slice, in a fixed order.
#[inline(always)]
pub(crate) fn sum_map<T: Scalar>(x: &[T], f: impl Fn(T) -> T) -> f64 {
    let mut total = 0.0;
    for block in x.chunks(BLOCK) {
        let mut lanes = [T::ZERO; LANES];
        let groups = block.chunks_exact(LANES);
        let rest = groups.remainder();
        for group in groups {
            for (lane, &v) in lanes.iter_mut().zip(group) {
                *lane += f(v);
            }
        }
        total += flush(&lanes);
        total += rest.iter().map(|&v| f(v).to_f64()).sum::<f64>();
    }
    total
}

/// Sums of `a` and of `a * (b - centre)` over two slices of one length, in a fixed order.
#[inline(always)]
pub(crate) fn sum_and_moment<T: Scalar>(a: &[T], b: &[T], centre: T) -> (f64, f64) {
    let (mut total, mut moment) = (0.0, 0.0);
    for (block_a, block_b) in a.chunks(BLOCK).zip(b.chunks(BLOCK)) {
        let (mut lanes, mut products) = ([T::ZERO; LANES], [T::ZERO; LANES]);
        let (groups_a, groups_b) = (block_a.chunks_exact(LANES), block_b.chunks_exact(LANES));
        let rest = groups_a.remainder().iter().zip(groups_b.remainder());
        for (group_a, group_b) in groups_a.zip(groups_b) {
            for l in 0..LANES {
                lanes[l] += group_a[l];
                products[l] += group_a[l] * (group_b[l] - centre);
            }
        }
        total += flush(&lanes);
        moment += flush(&products);
        for (&u, &v) in rest {
            total += u.to_f64();
            moment += (u * (v - centre)).to_f64();
        }
    }
    (total, moment)
}

fn flush<T: Scalar>(lanes: &[T; LANES]) -> f64 {
    lanes.iter().map(|v| v.to_f64()).sum()
}

/// `out[i] += x[i]`.
#[inline(always)]
pub(crate) fn add_row<T: Scalar>(out: &mut [T], x: &[T]) {
    for (o, &v) in out.iter_mut().zip(x) {
        *o += v;
    }
}

/// `out[i] += scale * x[i]`.
#[inline(always)]
pub(crate) fn add_scaled_row<T: Scalar>(out: &mut [T], scale: T, x: &[T]) {
    for (o, &v) in out.iter_mut().zip(x) {
        *o += scale * v;
    }
}

/// A square pooling window over one plane, with the output size that follows.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Window {
    pub(crate) height: usize,
    pub(crate) width: usize,
    pub(crate) kernel: usize,
    pub(crate) stride: usize,
    pub(crate) padding: usize,
    pub(crate) out_height: usize,
    pub(crate) out_width: usize,
}

impl Window {
    /// The window of `op` over the planes of `shape`; output size floor((size + 2 padding - kernel) / stride) + 1.
    #[track_caller]
    pub(crate) fn new(op: &str, shape: Shape, kernel: usize, stride: usize, padding: usize) -> Self {
        let (height, width) = (shape.h(), shape.w());
        assert!(
            kernel >= 1 && stride >= 1,
            "{op}: input {shape} with kernel {kernel} and stride {stride}; the rule: both at least 1"
        );
        assert!(
            2 * padding <= kernel,
            "{op}: input {shape} with padding {padding}; the rule: at most half of the kernel {kernel}"
        );
        assert!(
            height.min(width) > 0 && height.min(width) + 2 * padding >= kernel,
            "{op}: input {shape} with padding {padding} must be at least as large as the kernel {kernel}"
        );
        let out = |n: usize| (n + 2 * padding - kernel) / stride + 1;
        let (out_height, out_width) = (out(height), out(width));
        Self { height, width, kernel, stride, padding, out_height, out_width }
    }

    /// Input rows covered by output row `oy`, padding left out.
    pub(crate) fn rows(&self, oy: usize) -> std::ops::Range<usize> {
        covered(oy * self.stride, self.kernel, self.padding, self.height)
    }

    /// Input columns covered by output column `ox`, padding left out.
    pub(crate) fn columns(&self, ox: usize) -> std::ops::Range<usize> {
        covered(ox * self.stride, self.kernel, self.padding, self.width)
    }
}

fn covered(start: usize, kernel: usize, padding: usize, size: usize) -> std::ops::Range<usize> {
    start.saturating_sub(padding)..(start + kernel).saturating_sub(padding).min(size)
}

/// Helpers of the tests of the ops that walk planes.
#[cfg(test)]
pub(crate) mod testing {
    use crate::{Shape, Tensor};

    /// A tensor from literal sizes and values.
    #[track_caller]
    pub(crate) fn tensor(sizes: [usize; 4], values: &[f64]) -> Tensor<f64> {
        Tensor::from_vec(Shape(sizes), values.to_vec())
    }

    /// Uniform values in `-1..1` of literal sizes.
    pub(crate) fn noise(seed: u64, sizes: [usize; 4]) -> Tensor<f64> {
        crate::gradcheck::random(seed, Shape(sizes), -1.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_agree_with_a_plain_loop_on_every_remainder() {
        for len in [0, 1, 15, 16, 17, 1023, 1024, 1057, 2500] {
            let x: Vec<f64> = (0..len).map(|i| ((i * 37 % 101) as f64) / 7.0 - 5.0).collect();
            let y: Vec<f64> = (0..len).map(|i| ((i * 53 % 97) as f64) / 9.0 - 4.0).collect();
            let squares: f64 = x.iter().map(|v| v * v).sum();
            assert!((sum_map(&x, |v| v * v) - squares).abs() <= 1e-9);
            let (total, moment) = sum_and_moment(&x, &y, 0.5);
            let expected: f64 = x.iter().zip(&y).map(|(a, b)| a * (b - 0.5)).sum();
            assert!((total - x.iter().sum::<f64>()).abs() <= 1e-9);
            assert!((moment - expected).abs() <= 1e-9);
        }
    }

    #[test]
    fn window_covers_only_the_plane() {
        let window = Window::new("test", Shape::new(1, 1, 5, 4), 3, 2, 1);
        assert_eq!((window.out_height, window.out_width), (3, 2));
        assert_eq!(window.rows(0), 0..2);
        assert_eq!(window.rows(2), 3..5);
        assert_eq!(window.columns(1), 1..4);
    }

    #[test]
    fn planes_are_numbered_across_groups() {
        let mut out = vec![0.0_f64; 3 * 9000 + 5 * 9000];
        for_each_plane(&mut out, 3000, |i, plane| plane.fill(i as f64));
        assert!(out.iter().enumerate().all(|(k, &v)| v == (k / 3000) as f64));
    }
}
