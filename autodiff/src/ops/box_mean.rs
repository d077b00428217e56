//! Mean over a k x k window around every pixel, stride 1, planes reflected at the border (edge not repeated).
//!
//! y[i, j] = 1/k^2 sum_{|a|, |b| <= k/2} x[r(i + a), r(j + b)], k odd, r the reflection of `pad_reflect`.
//! vjp: the transposed filter; the reflected cells add to the cells they mirror.  Kinks: none, the op is linear.
//! Keeps: nothing.
//!
//! The filter is separable: rows are summed first, then columns, directly (no running sums), so the rounding error of
//! one window does not depend on the rest of the plane.

use super::pad::{Edge, fill_ends, fold_ends};
use super::planes::{add_row, for_each_plane};
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, total};
use crate::{Scalar, Shape, Var};

/// `out[i] = sum_{d < k} x[i + d]`; `x` has `k - 1` elements more than `out`.
#[inline(always)]
fn sum_shifted<T: Scalar>(x: &[T], out: &mut [T], k: usize) {
    let w = out.len();
    if k == 3 {
        let (a, b, c) = (&x[..w], &x[1..w + 1], &x[2..w + 2]);
        for (((o, &a), &b), &c) in out.iter_mut().zip(a).zip(b).zip(c) {
            *o = a + b + c;
        }
        return;
    }
    out.copy_from_slice(&x[..w]);
    for d in 1..k {
        add_row(out, &x[d..d + w]);
    }
}

/// Sum of the `k` rows around row `i` into `out`.
#[inline(always)]
fn sum_rows<T: Scalar>(x: &[T], out: &mut [T], i: usize, k: usize) {
    let w = out.len();
    let row = |d: usize| {
        let start = Edge::Reflect.source(i + d, k / 2, x.len() / w) * w;
        &x[start..start + w]
    };
    if k == 3 {
        for (((o, &a), &b), &c) in out.iter_mut().zip(row(0)).zip(row(1)).zip(row(2)) {
            *o = a + b + c;
        }
        return;
    }
    out.copy_from_slice(row(0));
    for d in 1..k {
        add_row(out, row(d));
    }
}

fn forward_plane<T: Scalar>(x: &[T], y: &mut [T], width: usize, k: usize) {
    let p = k / 2;
    let scale = T::from_f64(1.0 / (k * k) as f64);
    let mut padded = vec![T::ZERO; width + 2 * p];
    for (i, out) in y.chunks_exact_mut(width).enumerate() {
        sum_rows(x, &mut padded[p..p + width], i, k);
        fill_ends(&mut padded, [p, p], Edge::Reflect);
        sum_shifted(&padded, out, k);
        for v in out {
            *v *= scale;
        }
    }
}

fn backward_plane<T: Scalar>(g: &[T], gx: &mut [T], width: usize, k: usize) {
    let p = k / 2;
    let height = gx.len() / width;
    gx.fill(T::ZERO);
    let scale = T::from_f64(1.0 / (k * k) as f64);
    let mut wide = vec![T::ZERO; width + 4 * p];
    let mut padded = vec![T::ZERO; width + 2 * p];
    for (i, row) in g.chunks_exact(width).enumerate() {
        for (o, &v) in wide[2 * p..2 * p + width].iter_mut().zip(row) {
            *o = v * scale;
        }
        sum_shifted(&wide, &mut padded, k);
        fold_ends(&mut padded, [p, p], Edge::Reflect);
        for d in 0..k {
            let target = Edge::Reflect.source(i + d, p, height) * width;
            add_row(&mut gx[target..target + width], &padded[p..p + width]);
        }
    }
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Mean over the `k` x `k` window around every pixel, with the planes reflected at the border.
    ///
    /// **Formula**: y[i, j] = 1/k^2 sum over |a|, |b| <= k/2 of x[i + a, j + b]. **Shapes**: (N, C, H, W) to the same.
    /// **Gradient**: the transposed filter (pixels next to the border receive the mirrored share as well).
    /// **Panics** unless `k` is odd and k/2 is smaller than H and W.
    /// Equals PyTorch's `avg_pool2d(pad(x, k/2, "reflect"), k, stride 1)`.
    #[track_caller]
    pub fn box_mean(self, k: usize) -> Var<'t, T> {
        let shape = self.shape();
        assert!(k % 2 == 1, "box_mean: input {shape} with window {k}; the rule: an odd one");
        assert!(
            k / 2 < shape.h() && k / 2 < shape.w(),
            "box_mean: input {shape:?}, window {k}: half the window must be smaller than height and width"
        );
        let (plane, width) = (shape.plane(), shape.w());
        let value = self.value();
        let mut y = self.tape().scratch(shape.len());
        for_each_plane(&mut y, plane, |i, out| {
            forward_plane(&value.data()[i * plane..(i + 1) * plane], out, width, k);
        });
        let y = self.tape().tensor(shape, y);
        self.tape().push("box_mean", y, &[self], move |g, grads| {
            if let Some(mut slot) = grads.slot(0) {
                slot.write(|gx| {
                    for_each_plane(gx, plane, |i, out| {
                        backward_plane(&g.data()[i * plane..][..plane], out, width, k);
                    });
                });
            }
        })
    }
}

#[derive(Clone, Copy, Debug)]
struct BoxMean(usize);

impl Twin for BoxMean {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].box_mean(self.0)
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let (x, k) = (&x[0], self.0);
        let mirrored = |i: usize, size: usize| {
            let i = (i as isize - (k / 2) as isize).unsigned_abs();
            if i >= size { 2 * (size - 1) - i } else { i }
        };
        Plain::from_fn(x.shape, |[n, c, i, j]| {
            let at = |t: usize| x.at([n, c, mirrored(i + t / k, x.shape.h()), mirrored(j + t % k, x.shape.w())]);
            total((0..k * k).map(at)) / N::constant((k * k) as f64)
        })
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("box_mean");
    let mut cases = Vec::new();
    for k in [1, 3, 5, 7] {
        for most in [0, 1, 3, 7] {
            let [n, c] = [draw.size(1, 2), draw.size(1, 3)];
            let shape = Shape::new(n, c, k / 2 + 1 + draw.size(0, most), k / 2 + 1 + draw.size(0, most));
            cases.push(Case::new(BoxMean(k), [draw.uniform(shape, -1.0, 1.0)]));
        }
    }
    cases.push(Case::new(BoxMean(3), [draw.uniform(Shape::new(2, 3, 11, 31), -1.0, 1.0)]));
    Proof::new("box_mean", cases)
}

#[cfg(test)]
mod tests {
    use crate::ops::planes::testing::{noise, tensor};
    use crate::ops::testing::{check, check_adjoint, close};
    use crate::{Shape, Tape, Tensor};

    #[test]
    fn three_by_three_of_a_small_plane() {
        // At the corner of 1 2 3 / 4 5 6 / 7 8 9 the mirrored window is 5 4 5 / 2 1 2 / 5 4 5.
        let tape = Tape::new();
        let x = tape.leaf(tensor([1, 1, 3, 3], &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]));
        let y = x.box_mean(3);
        close(y.value().data(), &[33.0, 36.0, 39.0, 42.0, 45.0, 48.0, 51.0, 54.0, 57.0].map(|v| v / 9.0));
        // Along one axis the three pixels are read 2, 5 and 2 times.
        let counts = [4.0, 10.0, 4.0, 10.0, 25.0, 10.0, 4.0, 10.0, 4.0].map(|v| v / 9.0);
        close(tape.backward(y.sum()).wrt(x).data(), &counts);
    }

    #[test]
    fn equals_reflected_padding_and_average_pooling() {
        for (k, sizes) in [(1, [1, 2, 1, 3]), (3, [2, 3, 5, 4]), (5, [1, 2, 3, 7]), (7, [1, 1, 6, 9])] {
            let tape = Tape::new();
            let x = tape.constant(noise(k as u64, sizes));
            close(x.box_mean(k).value().data(), x.pad_reflect(k / 2).avg_pool2d(k, 1, 0).value().data());
        }
    }

    #[test]
    fn constant_planes_stay_constant() {
        let tape = Tape::new();
        let y = tape.constant(Tensor::full(Shape::new(2, 1, 4, 6), 0.75)).box_mean(3);
        close(y.value().data(), &[0.75; 48]);
    }

    #[test]
    fn transpose_and_finite_differences() {
        for (k, sizes) in [(3, [2, 2, 5, 7]), (3, [1, 1, 2, 2]), (7, [1, 2, 4, 6]), (1, [2, 1, 1, 1])] {
            check_adjoint(Shape(sizes), 3, |x| x.box_mean(k));
        }
        check(&[noise(4, [1, 2, 3, 5])], |v| v[0].box_mean(3).square());
    }

    #[test]
    #[should_panic(expected = "box_mean: input [1, 1, 1, 5], window 3")]
    fn rejects_planes_too_small_to_reflect() {
        let tape = Tape::new();
        tape.constant(noise(1, [1, 1, 1, 5])).box_mean(3);
    }

    #[test]
    #[should_panic(expected = "with window 4; the rule: an odd one")]
    fn rejects_even_windows() {
        let tape = Tape::new();
        tape.constant(noise(1, [1, 1, 5, 5])).box_mean(4);
    }
}
