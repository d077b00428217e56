//! Padding by `p` on all four sides of every plane: reflected or replicated.
//!
//! y[i, j] = x[r(i - p), r(j - p)], where for reflection r(-a) = a and r(H - 1 + a) = H - 1 - a (the edge itself is
//! not repeated), and for replication r clamps to [0, H - 1].
//! vjp: the transposed gather, gx[r(i - p), r(j - p)] += g[i, j].  Kinks: none, the op is linear.  Keeps: nothing.

use super::planes::{add_row, for_each_plane};
use crate::{Scalar, Shape, Var};

/// Which element stands in for one that lies outside the plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Edge {
    /// Mirror about the edge element, which is not repeated.
    Reflect,
    /// Repeat the edge element.
    Replicate,
}

impl Edge {
    /// Element of `0..size` that padded position `i` (counted from `-padding`) reads.
    #[inline(always)]
    pub(crate) fn source(self, i: usize, padding: usize, size: usize) -> usize {
        let inside = i.wrapping_sub(padding);
        match self {
            _ if i >= padding && inside < size => inside,
            Edge::Reflect if i < padding => padding - i,
            Edge::Reflect => 2 * (size - 1) - inside,
            Edge::Replicate if i < padding => 0,
            Edge::Replicate => size - 1,
        }
    }
}

/// Fills the `padding` cells at both ends of a row whose middle is already in place.
#[inline(always)]
pub(crate) fn fill_ends<T: Scalar>(row: &mut [T], padding: usize, edge: Edge) {
    let width = row.len() - 2 * padding;
    for i in 0..padding {
        row[i] = row[padding + edge.source(i, padding, width)];
        let right = padding + width + i;
        row[right] = row[padding + edge.source(right, padding, width)];
    }
}

/// Transpose of [`fill_ends`]: adds the end cells onto the middle cells that they were copied from.
#[inline(always)]
pub(crate) fn fold_ends<T: Scalar>(row: &mut [T], padding: usize, edge: Edge) {
    let width = row.len() - 2 * padding;
    for i in 0..padding {
        let left = row[i];
        row[padding + edge.source(i, padding, width)] += left;
        let right = row[padding + width + i];
        row[padding + edge.source(padding + width + i, padding, width)] += right;
    }
}

fn forward_plane<T: Scalar>(x: &[T], y: &mut [T], width: usize, padding: usize, edge: Edge) {
    let height = x.len() / width;
    for (i, row) in y.chunks_exact_mut(width + 2 * padding).enumerate() {
        let source = edge.source(i, padding, height) * width;
        row[padding..padding + width].copy_from_slice(&x[source..source + width]);
        fill_ends(row, padding, edge);
    }
}

fn backward_plane<T: Scalar>(g: &[T], gx: &mut [T], width: usize, padding: usize, edge: Edge) {
    let height = gx.len() / width;
    gx.fill(T::ZERO);
    let mut folded = vec![T::ZERO; width + 2 * padding];
    for (i, row) in g.chunks_exact(width + 2 * padding).enumerate() {
        folded.copy_from_slice(row);
        fold_ends(&mut folded, padding, edge);
        let target = edge.source(i, padding, height) * width;
        add_row(&mut gx[target..target + width], &folded[padding..padding + width]);
    }
}

fn pad<'t, T: Scalar>(op: &'static str, x: Var<'t, T>, padding: usize, edge: Edge) -> Var<'t, T> {
    let [n, c, h, w] = x.shape().0;
    let shape = Shape::new(n, c, h + 2 * padding, w + 2 * padding);
    let value = x.value();
    let mut y = x.tape().scratch(shape.len());
    for_each_plane(&mut y, shape.plane(), |i, plane| {
        forward_plane(&value.data()[i * h * w..(i + 1) * h * w], plane, w, padding, edge);
    });
    let y = x.tape().tensor(shape, y);
    x.tape().push(op, y, &[x], move |g, grads| {
        if let Some(mut slot) = grads.slot(0) {
            let padded = shape.plane();
            slot.write(|gx| {
                for_each_plane(gx, h * w, |i, plane| {
                    backward_plane(&g.data()[i * padded..][..padded], plane, w, padding, edge);
                });
            });
        }
    })
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Pads every plane by `padding` on each side, mirrored about the edge element (which is not repeated).
    ///
    /// **Shapes**: (N, C, H, W) to (N, C, H + 2p, W + 2p).
    /// **Gradient**: sums over all copies of an element.
    /// **Panics** unless `padding` is smaller than both H and W. Equals PyTorch's `pad(mode="reflect")`.
    #[track_caller]
    pub fn pad_reflect(self, padding: usize) -> Var<'t, T> {
        let shape = self.shape();
        assert!(
            padding < shape.h() && padding < shape.w(),
            "pad_reflect: input {shape:?}, padding {padding}: the padding must be smaller than height and width"
        );
        pad("pad_reflect", self, padding, Edge::Reflect)
    }

    /// Pads every plane by `padding` on each side with copies of the edge element.
    ///
    /// **Shapes**: (N, C, H, W) to (N, C, H + 2p, W + 2p).
    /// **Gradient**: sums over all copies of an element.
    /// **Panics** when a plane is empty. Equals PyTorch's `pad(mode="replicate")`.
    #[track_caller]
    pub fn pad_replicate(self, padding: usize) -> Var<'t, T> {
        let shape = self.shape();
        assert!(shape.plane() > 0, "pad_replicate: input {shape:?}: planes must not be empty");
        pad("pad_replicate", self, padding, Edge::Replicate)
    }
}

#[cfg(test)]
mod tests {
    use crate::Tape;
    use crate::ops::planes::testing::{noise, tensor};
    use crate::ops::testing::{check, check_adjoint, close};

    #[test]
    fn reflection_skips_the_edge_and_replication_repeats_it() {
        let tape = Tape::new();
        let x = tape.constant(tensor([1, 1, 1, 3], &[1.0, 2.0, 3.0]));
        close(x.pad_replicate(2).value().data(), &[[1.0, 1.0, 1.0, 2.0, 3.0, 3.0, 3.0]; 5].concat());
        let x = tape.constant(tensor([1, 1, 2, 3], &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]));
        let top = [2.0, 1.0, 2.0, 3.0, 2.0];
        let bottom = [5.0, 4.0, 5.0, 6.0, 5.0];
        close(x.pad_reflect(1).value().data(), &[bottom, top, bottom, top].concat());
    }

    #[test]
    fn gradient_counts_the_copies() {
        let tape = Tape::new();
        let x = tape.leaf(noise(1, [1, 1, 2, 3]));
        let grads = tape.backward(x.pad_reflect(1).sum());
        close(grads.wrt(x).data(), &[2.0, 6.0, 2.0, 2.0, 6.0, 2.0]);
        let grads = tape.backward(x.pad_replicate(1).sum());
        close(grads.wrt(x).data(), &[4.0, 2.0, 4.0, 4.0, 2.0, 4.0]);
    }

    #[test]
    fn padding_is_linear_with_the_right_transpose() {
        for (sizes, p) in [([2, 3, 4, 5], 2), ([1, 2, 7, 3], 1), ([3, 1, 3, 9], 0), ([1, 1, 4, 6], 3)] {
            let shape = noise(2, sizes).shape();
            check_adjoint(shape, 3, |x| x.pad_reflect(p));
            check_adjoint(shape, 4, |x| x.pad_replicate(p + 1));
        }
        check_adjoint(noise(2, [2, 1, 1, 1]).shape(), 5, |x| x.pad_replicate(2));
    }

    #[test]
    fn gradient_matches_finite_differences() {
        let x = noise(3, [2, 2, 3, 5]);
        check(std::slice::from_ref(&x), |v| v[0].pad_reflect(2).square());
        check(&[x], |v| v[0].pad_replicate(3).square());
    }

    #[test]
    #[should_panic(expected = "pad_reflect: input [1, 1, 3, 2], padding 2")]
    fn reflection_rejects_padding_as_wide_as_the_plane() {
        let tape = Tape::new();
        tape.constant(noise(1, [1, 1, 3, 2])).pad_reflect(2);
    }

    #[test]
    #[should_panic(expected = "pad_replicate: input [1, 1, 0, 2]")]
    fn replication_rejects_empty_planes() {
        let tape = Tape::new();
        tape.constant(noise(1, [1, 1, 0, 2])).pad_replicate(1);
    }
}
