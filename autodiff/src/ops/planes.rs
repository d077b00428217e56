//! Walking tensors plane by plane, and row helpers shared by the spatial ops.
//!
//! Every task owns a fixed number of whole planes, chosen from the plane size alone, so the result does not depend on
//! the number of threads.

use crate::{Scalar, Shape, par};

/// Elements that one task should cover at least; a plane larger than this is a task of its own.
const TASK_ELEMENTS: usize = 8192;
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
    fn window_covers_only_the_plane() {
        let window = Window::new("test", Shape::new(1, 1, 5, 4), 3, 2, 1);
        assert_eq!((window.out_height, window.out_width), (3, 2));
        assert_eq!(window.rows(0), 0..2);
        assert_eq!(window.rows(2), 3..5);
    }

    #[test]
    fn planes_are_numbered_across_groups() {
        let mut out = vec![0.0_f64; 3 * 9000 + 5 * 9000];
        for_each_plane(&mut out, 3000, |i, plane| plane.fill(i as f64));
        assert!(out.iter().enumerate().all(|(k, &v)| v == (k / 3000) as f64));
    }
}
