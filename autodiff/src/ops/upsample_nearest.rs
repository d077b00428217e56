//! Nearest-neighbour enlargement by an integer factor r: every element becomes an r x r block.
//!
//! y[i, j] = x[i div r, j div r].
//! vjp: the sum of g over the block.  Kinks: none, the op is linear.  Keeps: nothing.

use super::planes::{add_row, for_each_plane};
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, shapes};
use crate::{Scalar, Var};

/// Writes every element `factor` times; twice, the usual case, in a loop of its own.
fn repeat_row<T: Scalar>(row: &[T], out: &mut [T], factor: usize) {
    if factor == 2 {
        for (&v, cells) in row.iter().zip(out.as_chunks_mut::<2>().0) {
            *cells = [v; 2];
        }
        return;
    }
    for (&v, cells) in row.iter().zip(out.chunks_exact_mut(factor)) {
        cells.fill(v);
    }
}

/// Transpose of [`repeat_row`]: the sum of every `factor` elements.
fn sum_cells<T: Scalar>(x: &[T], out: &mut [T], factor: usize) {
    for (o, cells) in out.iter_mut().zip(x.chunks_exact(factor)) {
        *o = cells.iter().fold(T::ZERO, |sum, &v| sum + v);
    }
}

fn forward_plane<T: Scalar>(x: &[T], y: &mut [T], width: usize, factor: usize) {
    let out_width = width * factor;
    for (row, block) in x.chunks_exact(width).zip(y.chunks_exact_mut(out_width * factor)) {
        let (first, others) = block.split_at_mut(out_width);
        repeat_row(row, first, factor);
        for other in others.chunks_exact_mut(out_width) {
            other.copy_from_slice(first);
        }
    }
}

/// Sums columns of a block, then its row; of a block of two, the usual case, at once.
fn backward_plane<T: Scalar>(g: &[T], gx: &mut [T], width: usize, factor: usize) {
    let out_width = width * factor;
    if factor == 2 {
        for (block, row) in g.chunks_exact(2 * out_width).zip(gx.chunks_exact_mut(width)) {
            let (first, second) = block.split_at(out_width);
            let cells = first.as_chunks::<2>().0.iter().zip(second.as_chunks::<2>().0);
            for (x, ([a, b], [c, d])) in row.iter_mut().zip(cells) {
                *x = (*a + *c) + (*b + *d);
            }
        }
        return;
    }
    let mut column = vec![T::ZERO; out_width];
    for (block, row) in g.chunks_exact(out_width * factor).zip(gx.chunks_exact_mut(width)) {
        let (first, others) = block.split_at(out_width);
        column.copy_from_slice(first);
        for other in others.chunks_exact(out_width) {
            add_row(&mut column, other);
        }
        sum_cells(&column, row, factor);
    }
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Repeats every element in a `factor` x `factor` block.
    ///
    /// **Shapes**: (N, C, H, W) to (N, C, factor H, factor W). **Gradient**: the sum over the block.
    /// **Panics** when `factor` is 0.
    #[track_caller]
    pub fn upsample_nearest(self, factor: usize) -> Var<'t, T> {
        let shape = self.shape();
        assert!(factor >= 1, "upsample_nearest: input {shape}, factor {factor}: the factor must be at least 1");
        let out_shape = shape.with_plane(shape.h() * factor, shape.w() * factor);
        let (plane, out_plane, width) = (shape.plane(), out_shape.plane(), shape.w());
        let x = self.value();
        let mut y = self.tape().scratch(out_shape.len());
        for_each_plane(&mut y, out_plane, |i, out| {
            forward_plane(&x.data()[i * plane..][..plane], out, width, factor);
        });
        let y = self.tape().tensor(out_shape, y);
        self.tape().push("upsample_nearest", y, &[self], move |g, grads| {
            if let Some(mut slot) = grads.slot(0) {
                slot.write(|gx| {
                    for_each_plane(gx, plane, |i, out| {
                        backward_plane(&g.data()[i * out_plane..][..out_plane], out, width, factor);
                    });
                });
            }
        })
    }
}

#[derive(Clone, Copy, Debug)]
struct UpsampleNearest(usize);

impl Twin for UpsampleNearest {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].upsample_nearest(self.0)
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let (x, r) = (&x[0], self.0);
        Plain::from_fn(x.shape.with_plane(r * x.shape.h(), r * x.shape.w()), |[n, c, i, j]| x.at([n, c, i / r, j / r]))
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("upsample_nearest");
    let mut cases = Vec::new();
    for shape in shapes(&mut draw) {
        for factor in if shape.len() > 500 { 2..3 } else { 1..5 } {
            cases.push(Case::new(UpsampleNearest(factor), [draw.uniform(shape, -1.0, 1.0)]));
        }
    }
    Proof::new("upsample_nearest", cases)
}

#[cfg(test)]
mod tests {
    use crate::ops::planes::testing::{noise, tensor};
    use crate::ops::testing::{check, check_adjoint, close};
    use crate::{Shape, Tape};

    #[test]
    fn each_element_becomes_a_block() {
        let tape = Tape::new();
        let x = tape.leaf(tensor([1, 1, 2, 2], &[1.0, 2.0, 3.0, 4.0]));
        let y = x.upsample_nearest(2);
        let (top, bottom) = ([1.0, 1.0, 2.0, 2.0], [3.0, 3.0, 4.0, 4.0]);
        close(y.value().data(), &[top, top, bottom, bottom].concat());
        close(tape.backward(y.sum()).wrt(x).data(), &[4.0; 4]);
    }

    #[test]
    fn transpose_and_finite_differences() {
        for (sizes, factor) in [([2, 3, 3, 5], 2), ([1, 2, 1, 4], 3), ([2, 1, 1, 1], 8), ([1, 1, 4, 3], 1)] {
            check_adjoint(Shape(sizes), 7, |x| x.upsample_nearest(factor));
        }
        check(&[noise(8, [2, 1, 3, 2])], |v| v[0].upsample_nearest(2).square());
    }

    #[test]
    fn pooling_undoes_it() {
        let tape = Tape::new();
        let x = noise(9, [2, 2, 3, 4]);
        let y = tape.constant(x.clone()).upsample_nearest(3).avg_pool2d(3, 3, 0).value();
        close(y.data(), x.data());
    }

    #[test]
    #[should_panic(expected = "upsample_nearest: input [1, 1, 2, 2], factor 0")]
    fn rejects_factor_zero() {
        let tape = Tape::new();
        tape.constant(noise(1, [1, 1, 2, 2])).upsample_nearest(0);
    }
}
