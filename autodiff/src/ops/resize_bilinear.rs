//! Bilinear resizing of planes to a given size, with either rule for the sample positions.
//!
//! y[i, j] = sum of the four neighbours of (s(i), s(j)), weighted bilinearly, where
//! half-pixel centres: s(i) = max(0, (i + 1/2) H/H' - 1/2);  aligned corners: s(i) = i (H - 1)/(H' - 1), 0 when H' = 1.
//! A neighbour index past the last element is the last element.
//! vjp: the transposed weights.  Kinks: none, the op is linear.  Keeps: the weights of rows and columns.
//!
//! Rows are blended first, then columns; there is no low-pass filter when the size shrinks.

use std::sync::Arc;

use super::planes::{add_scaled_row, for_each_plane};
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin};
use crate::{Scalar, Shape, Var};

/// The two neighbours of one output position and their weights.
#[derive(Clone, Copy, Debug)]
struct Tap<T> {
    low: usize,
    high: usize,
    low_weight: T,
    high_weight: T,
}

/// Weights of all output positions of one axis.
fn axis_taps<T: Scalar>(size: usize, out: usize, align_corners: bool) -> Vec<Tap<T>> {
    let position = |i: usize| {
        if align_corners {
            if out > 1 { i as f64 * ((size - 1) as f64 / (out - 1) as f64) } else { 0.0 }
        } else {
            ((i as f64 + 0.5) * (size as f64 / out as f64) - 0.5).max(0.0)
        }
    };
    let tap = |i: usize| {
        let s = position(i);
        let low = (s as usize).min(size - 1);
        let part = (s - low as f64).min(1.0);
        let (low_weight, high_weight) = (T::from_f64(1.0 - part), T::from_f64(part));
        Tap { low, high: (low + 1).min(size - 1), low_weight, high_weight }
    };
    (0..out).map(tap).collect()
}

/// The weights of both axes and the row lengths.
struct Plan<T> {
    rows: Vec<Tap<T>>,
    columns: Vec<Tap<T>>,
    width: usize,
}

impl<T: Scalar> Plan<T> {
    fn forward_plane(&self, x: &[T], y: &mut [T]) {
        let mut blended = vec![T::ZERO; self.width];
        for (tap, out) in self.rows.iter().zip(y.chunks_exact_mut(self.columns.len())) {
            let (low, high) = (&x[tap.low * self.width..][..self.width], &x[tap.high * self.width..][..self.width]);
            for ((b, &l), &h) in blended.iter_mut().zip(low).zip(high) {
                *b = tap.low_weight * l + tap.high_weight * h;
            }
            for (o, tap) in out.iter_mut().zip(&self.columns) {
                *o = tap.low_weight * blended[tap.low] + tap.high_weight * blended[tap.high];
            }
        }
    }

    fn backward_plane(&self, g: &[T], gx: &mut [T]) {
        let mut blended = vec![T::ZERO; self.width];
        gx.fill(T::ZERO);
        for (tap, grad) in self.rows.iter().zip(g.chunks_exact(self.columns.len())) {
            blended.fill(T::ZERO);
            for (&g, tap) in grad.iter().zip(&self.columns) {
                blended[tap.low] += tap.low_weight * g;
                blended[tap.high] += tap.high_weight * g;
            }
            add_scaled_row(&mut gx[tap.low * self.width..][..self.width], tap.low_weight, &blended);
            add_scaled_row(&mut gx[tap.high * self.width..][..self.width], tap.high_weight, &blended);
        }
    }
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Resizes every plane to `height` x `width` by bilinear interpolation.
    ///
    /// **Shapes**: (N, C, H, W) to (N, C, height, width).
    /// **Gradient**: the transposed weights. `align_corners` has the meaning of PyTorch's argument: corners stay corners
    /// when true, pixel areas are matched (half-pixel centres) when false.
    /// **Panics** when the requested size is empty.
    #[track_caller]
    pub fn resize_bilinear(self, height: usize, width: usize, align_corners: bool) -> Var<'t, T> {
        let shape = self.shape();
        assert!(height > 0 && width > 0, "resize_bilinear: input {shape} to {height}x{width}; the rule: at least 1x1");
        let out_shape = shape.with_plane(height, width);
        let (plane, out_plane) = (shape.plane(), out_shape.plane());
        let plan = Arc::new(Plan {
            rows: axis_taps(shape.h(), height, align_corners),
            columns: axis_taps(shape.w(), width, align_corners),
            width: shape.w(),
        });
        let x = self.value();
        let mut y = self.tape().scratch(out_shape.len());
        for_each_plane(&mut y, out_plane, |i, out| plan.forward_plane(&x.data()[i * plane..][..plane], out));
        let y = self.tape().tensor(out_shape, y);
        self.tape().push("resize_bilinear", y, &[self], move |g, grads| {
            if let Some(mut slot) = grads.slot(0) {
                slot.write(|gx| {
                    for_each_plane(gx, plane, |i, out| {
                        plan.backward_plane(&g.data()[i * out_plane..][..out_plane], out);
                    });
                });
            }
        })
    }
}

#[derive(Clone, Copy, Debug)]
struct ResizeBilinear {
    height: usize,
    width: usize,
    align_corners: bool,
}

impl Twin for ResizeBilinear {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].resize_bilinear(self.height, self.width, self.align_corners)
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let x = &x[0];
        let spot = |i: usize, from: usize, to: usize| {
            let at = match self.align_corners {
                true => i as f64 * (from as f64 - 1.0) / (to as f64 - 1.0).max(1.0),
                false => ((i as f64 + 0.5) * from as f64 / to as f64 - 0.5).max(0.0),
            };
            let first = (at as usize).min(from - 1);
            (first, (first + 1).min(from - 1), N::constant(at - first as f64))
        };
        Plain::from_fn(x.shape.with_plane(self.height, self.width), |[n, c, i, j]| {
            let (up, down, b) = spot(i, x.shape.h(), self.height);
            let (left, right, a) = spot(j, x.shape.w(), self.width);
            let row = |h| (N::one() - a) * x.at([n, c, h, left]) + a * x.at([n, c, h, right]);
            (N::one() - b) * row(up) + b * row(down)
        })
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("resize_bilinear");
    let mut cases = Vec::new();
    let sizes = [
        ([1, 1, 1, 1], [1, 1]),
        ([1, 1, 1, 1], [3, 2]),
        ([2, 3, 5, 4], [1, 1]),
        ([1, 2, 3, 4], [6, 8]),
        ([1, 2, 6, 8], [3, 4]),
        ([2, 1, 5, 7], [5, 7]),
        ([1, 1, 1, 6], [4, 9]),
        ([3, 2, 4, 1], [7, 1]),
        ([1, 2, 7, 5], [3, 11]),
        ([2, 2, 3, 2], [10, 5]),
        ([2, 3, 11, 31], [9, 20]),
        ([1, 1, 5, 4], [37, 31]),
    ];
    for (shape, [height, width]) in sizes {
        for align_corners in [false, true] {
            cases.push(Case::new(ResizeBilinear { height, width, align_corners }, [draw.uniform(Shape(shape), -1.0, 1.0)]));
        }
    }
    Proof::new("resize_bilinear", cases)
}

#[cfg(test)]
mod tests {
    use crate::ops::planes::testing::{noise, tensor};
    use crate::ops::testing::{check, check_adjoint, close};
    use crate::{Shape, Tape, Tensor};

    fn resized(x: Tensor<f64>, height: usize, width: usize, align: bool) -> Vec<f64> {
        Tape::new().constant(x).resize_bilinear(height, width, align).value().to_vec()
    }

    #[test]
    fn doubling_by_either_rule() {
        let x = tensor([1, 1, 1, 2], &[1.0, 5.0]);
        close(&resized(x.clone(), 1, 4, false), &[1.0, 2.0, 4.0, 5.0]);
        close(&resized(x, 1, 4, true), &[1.0, 7.0 / 3.0, 11.0 / 3.0, 5.0]);
    }

    #[test]
    fn rows_and_columns_by_the_half_pixel_rule() {
        let x = tensor([1, 1, 2, 2], &[0.0, 4.0, 8.0, 20.0]);
        // Columns first: 0 1 3 4 and 8 11 17 20; then the rows in the ratios 1:0, 3:1, 1:3, 0:1.
        let expected = [0.0, 1.0, 3.0, 4.0, 2.0, 3.5, 6.5, 8.0, 6.0, 8.5, 13.5, 16.0, 8.0, 11.0, 17.0, 20.0];
        close(&resized(x, 4, 4, false), &expected);
    }

    #[test]
    fn shrinking_takes_two_neighbours_only() {
        let x = tensor([1, 1, 1, 6], &[0.0, 1.0, 2.0, 3.0, 4.0, 50.0]);
        close(&resized(x.clone(), 1, 2, false), &[1.0, 4.0]);
        close(&resized(x.clone(), 1, 3, true), &[0.0, 2.5, 50.0]);
        close(&resized(x, 1, 1, true), &[0.0]);
    }

    #[test]
    fn keeping_the_size_keeps_the_values() {
        let x = noise(1, [2, 3, 4, 5]);
        close(&resized(x.clone(), 4, 5, false), x.data());
        close(&resized(x.clone(), 4, 5, true), x.data());
    }

    #[test]
    fn transpose_and_finite_differences() {
        for (sizes, (h, w)) in [([2, 2, 3, 5], (6, 10)), ([1, 1, 5, 3], (2, 7)), ([2, 1, 1, 4], (3, 1))] {
            for align in [false, true] {
                check_adjoint(Shape(sizes), 9, |x| x.resize_bilinear(h, w, align));
            }
        }
        check(&[noise(3, [1, 2, 3, 2])], |v| v[0].resize_bilinear(5, 4, false).square());
    }

    #[test]
    #[should_panic(expected = "resize_bilinear: input [1, 1, 2, 2] to 0x3")]
    fn rejects_an_empty_result() {
        resized(noise(1, [1, 1, 2, 2]), 0, 3, true);
    }
}
