//! All-pairs correlation of two feature maps: one plane over the second map for every pixel of the first.
//!
//! V[n, p, q] = 1/sqrt(C) sum_c f1[n, c, p] f2[n, c, q], a matrix product per sample.
//! vjp: gf1 = f2 g^T / sqrt(C), gf2 = f1 g / sqrt(C).  Kinks: none, bilinear.  Keeps: both maps, each only when the other
//! one needs its gradient.

use crate::gemm::View;
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, total};
use crate::{Scalar, Shape, Tensor, Var, par};

/// Rows of the volume that one product computes.
const ROWS: usize = 128;

/// Copies the columns `start..start + count` of a row-major matrix with `cols` columns, transposed and scaled.
fn scaled_columns<T: Scalar>(matrix: &[T], cols: usize, start: usize, count: usize, scale: T) -> Vec<T> {
    let rows = matrix.len() / cols;
    let mut out = vec![T::ZERO; rows * count];
    for (c, row) in matrix.chunks_exact(cols).enumerate() {
        for (p, &v) in row[start..start + count].iter().enumerate() {
            out[p * rows + c] = v * scale;
        }
    }
    out
}

/// Channels, pixels of the first map and pixels of the second map.
#[derive(Clone, Copy, Debug)]
struct Sizes {
    c: usize,
    p: usize,
    q: usize,
}

impl Sizes {
    fn scale<T: Scalar>(self) -> T {
        T::from_f64(1.0 / (self.c as f64).sqrt())
    }

    /// Planes of the volume in blocks of [`ROWS`]; the last block of a sample may be shorter, so samples are cut first.
    fn forward<T: Scalar>(self, first: &[T], second: &[T], volume: &mut [T]) {
        let blocks: Vec<(usize, usize, &mut [T])> = volume
            .chunks_mut(self.p * self.q)
            .enumerate()
            .flat_map(|(n, sample)| sample.chunks_mut(ROWS * self.q).enumerate().map(move |(b, out)| (n, b, out)))
            .collect();
        par::for_each_item(blocks, |_, (n, block, out)| {
            let count = out.len() / self.q;
            let first = &first[n * self.c * self.p..][..self.c * self.p];
            let rows = scaled_columns(first, self.p, block * ROWS, count, self.scale());
            let second = View::new(&second[n * self.c * self.q..][..self.c * self.q], self.c, self.q);
            T::gemm(out, View::new(&rows, count, self.c), second, false);
        });
    }

    fn backward_first<T: Scalar>(self, g: &[T], second: &[T], gradient: &mut [T]) {
        par::for_each_chunk(gradient, self.c * self.p, |n, out| {
            let second = View::new(&second[n * self.c * self.q..][..self.c * self.q], self.c, self.q);
            let g = View::transpose_of(&g[n * self.p * self.q..][..self.p * self.q], self.q, self.p);
            T::gemm(out, second, g, false);
            let scale = self.scale();
            out.iter_mut().for_each(|v| *v *= scale);
        });
    }

    fn backward_second<T: Scalar>(self, g: &[T], first: &[T], gradient: &mut [T]) {
        par::for_each_chunk(gradient, self.c * self.q, |n, out| {
            let first = View::new(&first[n * self.c * self.p..][..self.c * self.p], self.c, self.p);
            let g = View::new(&g[n * self.p * self.q..][..self.p * self.q], self.p, self.q);
            T::gemm(out, first, g, false);
            let scale = self.scale();
            out.iter_mut().for_each(|v| *v *= scale);
        });
    }
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Correlation of every pixel of this map with every pixel of `other`.
    ///
    /// **Formula**: inner product over the channels divided by sqrt(C).
    /// **Shapes**: (N, C, H, W) and (N, C, H2, W2) to (N H W, 1, H2, W2): plane n H W + y W + x belongs to pixel (x, y).
    /// **Gradient**: to both maps.
    /// **Panics** when samples or channels differ.
    #[track_caller]
    pub fn correlation(self, other: Var<'t, T>) -> Var<'t, T> {
        let (s1, s2) = (self.shape(), other.shape());
        assert!(s1.n() == s2.n() && s1.c() == s2.c(), "correlation: needs [n, c, h, w] and [n, c, h2, w2], got {s1} and {s2}");
        let sizes = Sizes { c: s1.c(), p: s1.plane(), q: s2.plane() };
        let (first, second) = (self.value(), other.value());
        let shape = Shape::new(s1.n() * s1.plane(), 1, s2.h(), s2.w());
        let mut volume = self.tape().scratch(shape.len());
        sizes.forward(first.data(), second.data(), &mut volume);
        let volume = self.tape().tensor(shape, volume);
        let first: Option<Tensor<T>> = other.requires_grad().then_some(first);
        let second: Option<Tensor<T>> = self.requires_grad().then_some(second);
        self.tape().push("correlation", volume, &[self, other], move |g, grads| {
            if let (Some(mut slot), Some(second)) = (grads.slot(0), &second) {
                slot.write(|out| sizes.backward_first(g.data(), second.data(), out));
            }
            if let (Some(mut slot), Some(first)) = (grads.slot(1), &first) {
                slot.write(|out| sizes.backward_second(g.data(), first.data(), out));
            }
        })
    }
}

#[derive(Clone, Copy, Debug)]
struct Correlation;

impl Twin for Correlation {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].correlation(v[1])
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let [n, c, h, w] = x[0].shape.0;
        let to = Shape::new(n * h * w, 1, x[1].shape.h(), x[1].shape.w());
        Plain::from_fn(to, |[pixel, _, i, j]| {
            let (n, y, z) = (pixel / (h * w), pixel / w % h, pixel % w);
            total((0..c).map(|c| x[0].at([n, c, y, z]) * x[1].at([n, c, i, j]))) / N::constant(c as f64).sqrt()
        })
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("correlation");
    let mut cases = Vec::new();
    let sizes = [
        ([1, 1, 1, 1], [1, 1]),
        ([2, 3, 3, 4], [3, 4]),
        ([1, 5, 2, 3], [4, 1]),
        ([3, 2, 1, 5], [2, 2]),
        ([1, 17, 3, 2], [1, 7]),
        ([2, 2, 2, 3], [3, 2]),
        ([2, 4, 3, 2], [2, 5]),
        ([1, 2, 7, 11], [3, 5]),
        ([2, 2, 13, 7], [3, 3]),
        ([1, 25, 9, 9], [2, 3]),
    ];
    for (i, (shape, [h, w])) in sizes.into_iter().enumerate() {
        let first = Shape(shape);
        let case = Case::new(Correlation, [draw.uniform(first, -1.0, 1.0), draw.uniform(first.with_plane(h, w), -1.0, 1.0)]);
        cases.push(if (5..7).contains(&i) { case.constant(i - 5) } else { case });
    }
    Proof::new("correlation", cases)
}

#[cfg(test)]
mod tests {
    use crate::ops::planes::testing::{noise, tensor};
    use crate::ops::testing::{check, check_adjoint, close};
    use crate::{Shape, Tape};

    #[test]
    fn worked_numbers_over_four_channels() {
        let tape = Tape::new();
        let first = tape.leaf(tensor([1, 4, 1, 2], &[1.0, 2.0, 0.0, 1.0, 3.0, 0.0, 1.0, 1.0]));
        let second = tape.leaf(tensor([1, 4, 1, 1], &[2.0, 4.0, 6.0, 8.0]));
        // Pixel 0 is (1, 0, 3, 1), pixel 1 is (2, 1, 0, 1); products 28 and 16, over sqrt(4).
        let volume = first.correlation(second);
        assert_eq!(volume.shape(), Shape::new(2, 1, 1, 1));
        close(volume.value().data(), &[14.0, 8.0]);
        let grads = tape.backward(volume.sum());
        close(grads.wrt(first).data(), &[1.0, 1.0, 2.0, 2.0, 3.0, 3.0, 4.0, 4.0]);
        close(grads.wrt(second).data(), &[1.5, 0.5, 1.5, 1.0]);
    }

    #[test]
    fn planes_are_ordered_by_sample_then_row_then_column() {
        let tape = Tape::new();
        let (a, b) = (noise(1, [2, 3, 11, 13]), noise(2, [2, 3, 4, 5]));
        let volume = tape.constant(a.clone()).correlation(tape.constant(b.clone())).value();
        assert_eq!(volume.shape(), Shape::new(2 * 11 * 13, 1, 4, 5));
        for (n, y, x, i, j) in [(0, 0, 0, 0, 0), (0, 10, 12, 3, 4), (1, 9, 11, 2, 1), (1, 3, 0, 0, 4)] {
            let expected: f64 = (0..3).map(|c| a.at(n, c, y, x) * b.at(n, c, i, j)).sum();
            close(&[volume.at(n * 143 + y * 13 + x, 0, i, j)], &[expected / 3.0_f64.sqrt()]);
        }
    }

    #[test]
    fn gradient_matches_finite_differences() {
        for (sizes, (h, w)) in [([2, 3, 2, 3], (3, 2)), ([1, 1, 1, 4], (2, 1)), ([1, 5, 1, 1], (1, 1))] {
            let other = noise(4, [sizes[0], sizes[1], h, w]);
            check(&[noise(3, sizes), other], |v| v[0].correlation(v[1]));
        }
    }

    #[test]
    fn linear_in_each_map() {
        let other = noise(5, [2, 3, 4, 3]);
        check_adjoint(Shape::new(2, 3, 5, 2), 6, |x| x.correlation(x.tape().constant(other.clone())));
        check_adjoint(Shape::new(2, 3, 5, 2), 7, |x| x.tape().constant(other.clone()).correlation(x));
    }

    #[test]
    #[should_panic(expected = "correlation: needs [n, c, h, w] and [n, c, h2, w2], got [1, 2, 3, 3] and [1, 4, 3, 3]")]
    fn rejects_different_channels() {
        let tape = Tape::new();
        tape.constant(noise(1, [1, 2, 3, 3])).correlation(tape.constant(noise(1, [1, 4, 3, 3])));
    }
}
