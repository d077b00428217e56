//! Enlargement of a coarse field by an integer factor f, each fine value a learned convex combination of nine coarse ones.
//!
//! m[k] = softmax over k of logits[n, k f^2 + a f + b, i, j], k = 3 ky + kx in 0..9;
//! y[n, c, f i + a, f j + b] = sum_k m[k] f x[n, c, i + ky - 1, j + kx - 1], zero outside the plane.
//! vjp, with z_k the neighbours times f: gx scatters f m g; glogits_k = m_k (e_k - sum_l m_l e_l), e_k = sum_c g_c z_k,c.
//! Kinks: none.  Keeps: the field and the weights m.

use super::planes::{add_row, for_each_plane};
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, total};
use crate::{Scalar, Shape, Var, par};

/// Plane size and factor.
#[derive(Clone, Copy, Debug)]
struct Sizes {
    height: usize,
    width: usize,
    factor: usize,
}

impl Sizes {
    fn plane(self) -> usize {
        self.height * self.width
    }

    /// Distance of consecutive neighbours k in the logits.
    fn stride(self) -> usize {
        self.factor * self.factor * self.plane()
    }

    /// Row `i` of the weights of neighbour `k` and sub-pixel `(a, b)`.
    #[inline(always)]
    fn row(self, k: usize, (a, b): (usize, usize), i: usize) -> std::ops::Range<usize> {
        let start = k * self.stride() + (a * self.factor + b) * self.plane() + i * self.width;
        start..start + self.width
    }

    /// A copy of the plane times the factor, with one cell of zeros around it.
    fn framed<T: Scalar>(self, plane: &[T]) -> Vec<T> {
        let factor = T::from_f64(self.factor as f64);
        let mut out = vec![T::ZERO; (self.height + 2) * (self.width + 2)];
        for (row, to) in plane.chunks_exact(self.width).zip(out[self.width + 2..].chunks_exact_mut(self.width + 2)) {
            for (o, &v) in to[1..].iter_mut().zip(row) {
                *o = v * factor;
            }
        }
        out
    }

    /// The `width` framed cells that neighbour `k` of row `i` reads.
    #[inline(always)]
    fn neighbours(self, k: usize, i: usize) -> std::ops::Range<usize> {
        let start = (i + k / 3) * (self.width + 2) + k % 3;
        start..start + self.width
    }

    /// All sub-pixels `(a, b)` of all rows.
    fn positions(self) -> impl Iterator<Item = ((usize, usize), usize)> {
        let f = self.factor;
        (0..self.height).flat_map(move |i| (0..f * f).map(move |s| ((s / f, s % f), i)))
    }

    /// Every `factor`-th element of fine row `factor i + a`, from `b` on.
    #[inline(always)]
    fn gather<T: Scalar>(self, fine: &[T], (a, b): (usize, usize), i: usize, out: &mut [T]) {
        let width = self.width * self.factor;
        let row = &fine[(i * self.factor + a) * width..][..width];
        for (o, cell) in out.iter_mut().zip(row.chunks_exact(self.factor)) {
            *o = cell[b];
        }
    }

    fn forward_plane<T: Scalar>(self, x: &[T], weights: &[T], y: &mut [T]) {
        let framed = self.framed(x);
        let fine_width = self.width * self.factor;
        let mut sum = vec![T::ZERO; self.width];
        for ((a, b), i) in self.positions() {
            sum.fill(T::ZERO);
            for k in 0..9 {
                let pairs = weights[self.row(k, (a, b), i)].iter().zip(&framed[self.neighbours(k, i)]);
                for (o, (&m, &v)) in sum.iter_mut().zip(pairs) {
                    *o += m * v;
                }
            }
            let row = &mut y[(i * self.factor + a) * fine_width..][..fine_width];
            for (cell, &v) in row.chunks_exact_mut(self.factor).zip(&sum) {
                cell[b] = v;
            }
        }
    }

    fn backward_plane<T: Scalar>(self, g: &[T], weights: &[T], gx: &mut [T]) {
        let mut framed = vec![T::ZERO; (self.height + 2) * (self.width + 2)];
        let mut fine = vec![T::ZERO; self.width];
        for (sub, i) in self.positions() {
            self.gather(g, sub, i, &mut fine);
            for k in 0..9 {
                let pairs = weights[self.row(k, sub, i)].iter().zip(&fine);
                for (o, (&m, &v)) in framed[self.neighbours(k, i)].iter_mut().zip(pairs) {
                    *o += m * v;
                }
            }
        }
        let factor = T::from_f64(self.factor as f64);
        for (row, from) in gx.chunks_exact_mut(self.width).zip(framed[self.width + 2..].chunks_exact(self.width + 2)) {
            for (o, &v) in row.iter_mut().zip(&from[1..]) {
                *o = v * factor;
            }
        }
    }

    /// Gradient of the logits of one sample: products over the channels, then the softmax.
    fn backward_logits<T: Scalar>(self, g: &[T], x: &[T], weights: &[T], out: &mut [T]) {
        let mut fine = vec![T::ZERO; self.width];
        out.fill(T::ZERO);
        let fine_plane = self.plane() * self.factor * self.factor;
        for (x, g) in x.chunks_exact(self.plane()).zip(g.chunks_exact(fine_plane)) {
            let framed = self.framed(x);
            for (sub, i) in self.positions() {
                self.gather(g, sub, i, &mut fine);
                for k in 0..9 {
                    let pairs = fine.iter().zip(&framed[self.neighbours(k, i)]);
                    for (o, (&g, &v)) in out[self.row(k, sub, i)].iter_mut().zip(pairs) {
                        *o += g * v;
                    }
                }
            }
        }
        let mut mean = vec![T::ZERO; self.width];
        for (sub, i) in self.positions() {
            mean.fill(T::ZERO);
            for k in 0..9 {
                let row = self.row(k, sub, i);
                for (o, (&m, &e)) in mean.iter_mut().zip(weights[row.clone()].iter().zip(&out[row])) {
                    *o += m * e;
                }
            }
            for k in 0..9 {
                let row = self.row(k, sub, i);
                for ((o, &m), &mean) in out[row.clone()].iter_mut().zip(&weights[row]).zip(&mean) {
                    *o = m * (*o - mean);
                }
            }
        }
    }

    /// Softmax over the nine neighbours of one sample, in place.
    fn softmax<T: Scalar>(self, logits: &mut [T]) {
        let (mut top, mut total) = (vec![T::ZERO; self.stride()], vec![T::ZERO; self.stride()]);
        top.copy_from_slice(&logits[..self.stride()]);
        for neighbour in logits.chunks_exact(self.stride()) {
            for (o, &v) in top.iter_mut().zip(neighbour) {
                *o = o.max(v);
            }
        }
        for neighbour in logits.chunks_exact_mut(self.stride()) {
            for (v, &top) in neighbour.iter_mut().zip(&top) {
                *v = (*v - top).exp();
            }
            add_row(&mut total, neighbour);
        }
        for neighbour in logits.chunks_exact_mut(self.stride()) {
            for (v, &total) in neighbour.iter_mut().zip(&total) {
                *v /= total;
            }
        }
    }
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Enlarges this field by `factor` with learned convex weights over the 3 x 3 coarse neighbours, and multiplies its
    /// values by `factor` (a flow in coarse pixels becomes one in fine pixels).
    ///
    /// **Shapes**: field (N, C, H, W), `logits` (N, 9 factor^2, H, W) with channel k factor^2 + a factor + b for neighbour
    /// k = 3 ky + kx and sub-pixel row a, column b; result (N, C, factor H, factor W).
    /// **Gradient**: to the field and to the logits, which pass a softmax over k inside.
    /// **Panics** when `factor` is 0 or the shapes disagree.
    #[track_caller]
    pub fn convex_upsample(self, logits: Var<'t, T>, factor: usize) -> Var<'t, T> {
        let shape = self.shape();
        let expected = shape.with_c(9 * factor * factor);
        assert!(
            factor > 0 && logits.shape() == expected && shape.plane() > 0,
            "convex_upsample: field {shape}, factor {factor}: needs logits of shape {expected}, got {}",
            logits.shape()
        );
        let sizes = Sizes { height: shape.h(), width: shape.w(), factor };
        let out_shape: Shape = shape.with_plane(shape.h() * factor, shape.w() * factor);
        let (plane, out_plane, sample) = (shape.plane(), out_shape.plane(), 9 * sizes.stride());
        let (x, channels) = (self.value(), shape.c());
        let mut weights = self.tape().scratch(expected.len());
        weights.copy_from_slice(logits.value().data());
        par::for_each_chunk(&mut weights, sample, |_, logits| sizes.softmax(logits));
        let weights = self.tape().tensor(expected, weights);
        let mut y = self.tape().scratch(out_shape.len());
        for_each_plane(&mut y, out_plane, |i, out| {
            let weights = &weights.data()[i / channels * sample..][..sample];
            sizes.forward_plane(&x.data()[i * plane..][..plane], weights, out);
        });
        let y = self.tape().tensor(out_shape, y);
        self.tape().push("convex_upsample", y, &[self, logits], move |g, grads| {
            let weights = |n: usize| &weights.data()[n * sample..][..sample];
            if let Some(mut slot) = grads.slot(0) {
                slot.write(|gx| {
                    for_each_plane(gx, plane, |i, out| {
                        sizes.backward_plane(&g.data()[i * out_plane..][..out_plane], weights(i / channels), out);
                    });
                });
            }
            if let Some(mut slot) = grads.slot(1) {
                slot.write(|gx| {
                    par::for_each_chunk(gx, sample, |n, out| {
                        let g = &g.data()[n * channels * out_plane..][..channels * out_plane];
                        let x = &x.data()[n * channels * plane..][..channels * plane];
                        sizes.backward_logits(g, x, weights(n), out);
                    });
                });
            }
        })
    }
}

#[derive(Clone, Copy, Debug)]
struct ConvexUpsample(usize);

impl Twin for ConvexUpsample {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].convex_upsample(v[1], self.0)
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let (field, logits, f) = (&x[0], &x[1], self.0);
        let to = field.shape.with_plane(f * field.shape.h(), f * field.shape.w());
        Plain::from_fn(to, |[n, c, row, column]| {
            let (i, j, sub) = (row / f, column / f, row % f * f + column % f);
            let weight = |k: usize| logits.at([n, k * f * f + sub, i, j]).exp();
            let near = |k: usize| field.or_zero(n, c, (i + k / 3) as isize - 1, (j + k % 3) as isize - 1);
            let all = total((0..9).map(weight));
            total((0..9).map(|k| weight(k) / all * near(k))) * N::constant(f as f64)
        })
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("convex_upsample");
    let mut cases = Vec::new();
    let sizes =
        [([1, 1, 1, 1], 1), ([1, 2, 2, 3], 2), ([2, 1, 3, 1], 3), ([1, 3, 1, 4], 2), ([2, 2, 2, 2], 1), ([1, 2, 3, 2], 4)];
    let more = [([1, 2, 2, 3], 2), ([1, 1, 3, 2], 2), ([1, 2, 5, 7], 2), ([1, 1, 2, 1], 8), ([1, 1, 7, 8], 2)];
    for (i, (shape, factor)) in sizes.into_iter().chain(more).enumerate() {
        let shape = Shape(shape);
        let logits = draw.uniform(shape.with_c(9 * factor * factor), -2.0, 2.0);
        let case = Case::new(ConvexUpsample(factor), [draw.uniform(shape, -1.0, 1.0), logits]);
        cases.push(if (6..8).contains(&i) { case.constant(i - 6) } else { case });
    }
    Proof::new("convex_upsample", cases)
}

#[cfg(test)]
mod tests {
    use crate::ops::planes::testing::noise;
    use crate::ops::testing::{check, check_adjoint, close};
    use crate::{Shape, Tape, Tensor};

    /// Logits that give neighbour `k` all the weight.
    fn only(k: usize, factor: usize, h: usize, w: usize) -> Tensor<f64> {
        let shape = Shape::new(1, 9 * factor * factor, h, w);
        Tensor::from_fn(shape, |_, c, _, _| if c / (factor * factor) == k { 1000.0 } else { 0.0 })
    }

    #[test]
    fn a_single_neighbour_is_a_shifted_nearest_enlargement() {
        let tape = Tape::new();
        let x = Tensor::from_vec(Shape::new(1, 1, 2, 2), vec![1.0, 2.0, 3.0, 4.0]);
        let at = |k| tape.constant(x.clone()).convex_upsample(tape.constant(only(k, 2, 2, 2)), 2).value();
        let (top, bottom) = ([2.0, 2.0, 4.0, 4.0], [6.0, 6.0, 8.0, 8.0]);
        close(at(4).data(), &[top, top, bottom, bottom].concat());
        // Neighbour 5 is the one to the right, 1 the one above; outside is zero.
        let (top, bottom) = ([4.0, 4.0, 0.0, 0.0], [8.0, 8.0, 0.0, 0.0]);
        close(at(5).data(), &[top, top, bottom, bottom].concat());
        let top = [2.0, 2.0, 4.0, 4.0];
        close(at(1).data(), &[[0.0; 4], [0.0; 4], top, top].concat());
    }

    #[test]
    fn equal_logits_average_the_nine() {
        let tape = Tape::new();
        let x = noise(1, [2, 2, 3, 4]);
        let y = tape.constant(x.clone()).convex_upsample(tape.constant(Tensor::full(Shape::new(2, 36, 3, 4), 0.7)), 2);
        let expected = tape.constant(x).avg_pool2d(3, 1, 1).scale(2.0).upsample_nearest(2);
        close(y.value().data(), expected.value().data());
    }

    #[test]
    fn sub_pixels_read_their_own_weights() {
        // Channel k f^2 + a f + b: only sub-pixel (1, 0) looks at the left neighbour (k = 3), the rest at the centre.
        let tape = Tape::new();
        let x = Tensor::from_vec(Shape::new(1, 1, 1, 2), vec![1.0, 10.0]);
        let shape = Shape::new(1, 36, 1, 2);
        let logits = Tensor::from_fn(shape, |_, c, _, _| {
            let k = if c % 4 == 2 { 3 } else { 4 };
            if c / 4 == k { 1000.0 } else { 0.0 }
        });
        let y = tape.constant(x).convex_upsample(tape.constant(logits), 2).value();
        close(y.data(), &[2.0, 2.0, 20.0, 20.0, 0.0, 2.0, 2.0, 20.0]);
    }

    #[test]
    fn gradient_matches_finite_differences() {
        for ([n, c, h, w], factor) in [([2, 2, 2, 3], 2), ([1, 1, 1, 2], 3), ([1, 3, 3, 1], 1)] {
            let logits = noise(3, [n, 9 * factor * factor, h, w]);
            check(&[noise(2, [n, c, h, w]), logits], |v| v[0].convex_upsample(v[1], factor));
        }
    }

    #[test]
    fn linear_in_the_field() {
        let logits = noise(5, [2, 81, 3, 4]);
        check_adjoint(Shape::new(2, 2, 3, 4), 6, |x| x.convex_upsample(x.tape().constant(logits.clone()), 3));
    }

    #[test]
    #[should_panic(expected = "convex_upsample: field [1, 2, 3, 3], factor 2: needs logits of shape [1, 36, 3, 3]")]
    fn rejects_logits_of_another_factor() {
        let tape = Tape::new();
        tape.constant(noise(1, [1, 2, 3, 3])).convex_upsample(tape.constant(noise(1, [1, 9, 3, 3])), 2);
    }
}
