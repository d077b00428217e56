//! `y[line, k] = x[line, index[line, k]]` along one axis: each line picks from itself. Vector-Jacobian product: `g` is added to
//! the entries that were picked, once for each time. Linear. Keeps: the indices, which take no gradient.
//!
//! Additions to one entry run in the order of `k`. An entry that is not picked reaches neither the value nor the gradient.

use super::axis::Lines;
use super::blocks::assert_axis;
use super::planes::for_each_plane;
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, shapes, with};
use crate::{GradSink, Scalar, Tensor, Var};

fn forward<T: Scalar>(x: &[T], index: &[T], y: &mut [T], from: Lines, to: Lines) {
    for_each_plane(y, to.block(), |block, y| {
        let (x, index) = (&x[block * from.block()..][..from.block()], &index[block * to.block()..][..to.block()]);
        for (y, index) in y.chunks_exact_mut(to.inner).zip(index.chunks_exact(to.inner)) {
            for (j, (y, &index)) in y.iter_mut().zip(index).enumerate() {
                *y = x[position(index) * from.inner + j];
            }
        }
    });
}

fn backward<T: Scalar>(index: &[T], grad_y: &[T], grad_x: &mut [T], from: Lines, to: Lines) {
    for_each_plane(grad_x, from.block(), |block, grad_x| {
        let own = block * to.block()..(block + 1) * to.block();
        grad_x.fill(T::ZERO);
        for (g, index) in grad_y[own.clone()].chunks_exact(to.inner).zip(index[own].chunks_exact(to.inner)) {
            for (j, (&g, &index)) in g.iter().zip(index).enumerate() {
                grad_x[position(index) * from.inner + j] += g;
            }
        }
    });
}

/// A whole number as a position.
#[inline(always)]
fn position<T: Scalar>(index: T) -> usize {
    index.to_f64() as usize
}

/// Records the gather of operation `op`; the indices are known to be whole numbers below the size of the axis.
pub(crate) fn record<'t, T: Scalar>(op: &'static str, x: Var<'t, T>, axis: usize, index: &Tensor<T>) -> Var<'t, T> {
    let (from, to) = (Lines::along(x.shape(), axis), Lines::along(index.shape(), axis));
    let mut y = x.tape().scratch(index.shape().len());
    forward(x.value().data(), index.data(), &mut y, from, to);
    let y = x.tape().tensor(index.shape(), y);
    let index = index.clone();
    x.tape().push(op, y, &[x], move |g: &Tensor<T>, grads: &mut GradSink<'_, T>| {
        if let Some(mut slot) = grads.slot(0) {
            slot.write(|out| backward(index.data(), g.data(), out, from, to));
        }
    })
}

impl<'t, T: Scalar> Var<'t, T> {
    /// The entries at `index` along `axis` (0 to 3 for n, c, h, w).
    ///
    /// **Shapes**: `index` has the shape of the operand except along `axis`, where its size is free; the result has its shape.
    /// Its entries are positions along `axis`, whole numbers from 0; [`Var::min_axis`] and [`Var::max_axis`] return such indices.
    ///
    /// **Gradient**: `g` to each picked entry, summed over repetitions; 0 to the others, none to the indices.
    ///
    /// **Panics** for an axis above 3, when the shapes differ in another axis, or for an index that is no whole number below the
    /// size of the axis. Equals PyTorch's `gather` for these shapes.
    #[track_caller]
    pub fn gather(self, axis: usize, index: &Tensor<T>) -> Var<'t, T> {
        let (shape, wanted) = (self.shape(), index.shape());
        assert_axis("gather", axis, shape);
        assert!(
            shape.with_axis(axis, wanted.0[axis]) == wanted,
            "gather along axis {axis}: index {wanted} does not go with {shape}; the rule: equal in every other axis"
        );
        let size = T::from_usize(shape.0[axis]);
        let fits = |i: &T| *i >= T::ZERO && *i < size && i.floor() == *i;
        if let Some(at) = index.data().iter().position(|i| !fits(i)) {
            let bad = index.data()[at];
            panic!(
                "gather along axis {axis} of {shape}: entry {at} of the index is {bad}; the rule: whole, from 0, below {size}"
            );
        }
        record("gather", self, axis, index)
    }
}

#[derive(Clone, Copy, Debug)]
struct Gather(usize);

impl Twin for Gather {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].gather(self.0, &v[1].value())
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        Plain::from_fn(x[1].shape, |i| x[0].at(with(i, self.0, x[1].at(i).value() as usize)))
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("gather");
    let mut cases = Vec::new();
    for (i, shape) in shapes(&mut draw).into_iter().enumerate() {
        let axes = if shape.len() > 500 { i % 4..i % 4 + 1 } else { 0..4 };
        for axis in axes {
            let picks = shape.with_axis(axis, draw.size(1, 5));
            let inputs = [draw.uniform(shape, -2.0, 2.0), draw.whole(picks, shape.0[axis])];
            cases.push(Case::new(Gather(axis), inputs).constant(1));
        }
    }
    Proof::new("gather", cases)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random, row};
    use crate::{Shape, Tape, Tensor};

    #[test]
    fn values_and_gradient_are_known_also_for_repeated_indices() {
        let tape = Tape::new();
        let x = tape.leaf(row(&[10.0, 20.0, 30.0]));
        let y = x.gather(3, &row(&[2.0, 0.0, 2.0, 2.0]));
        close(y.value().data(), &[30.0, 10.0, 30.0, 30.0]);
        let loss = y.mul(tape.constant(row(&[1.0, 2.0, 4.0, 8.0]))).sum();
        close(tape.backward(loss).wrt(x).data(), &[2.0, 0.0, 13.0]);
    }

    #[test]
    fn every_line_picks_from_itself() {
        let tape = Tape::new();
        let x = tape.leaf(Tensor::from_vec(Shape::new(1, 2, 1, 3), vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0]));
        let y = x.gather(1, &Tensor::from_vec(Shape::new(1, 1, 1, 3), vec![1.0, 0.0, 1.0]));
        close(y.value().data(), &[4.0, 2.0, 6.0]);
        close(tape.backward(y.sum()).wrt(x).data(), &[0.0, 1.0, 0.0, 1.0, 0.0, 1.0]);
    }

    #[test]
    fn picked_nan_shows_and_other_nan_does_not() {
        let tape = Tape::new();
        let x = tape.leaf(row(&[f64::NAN, 2.0]));
        close(x.gather(3, &row(&[1.0])).value().data(), &[2.0]);
        assert!(x.gather(3, &row(&[0.0])).value().item().is_nan());
    }

    #[test]
    #[should_panic(expected = "gather along axis 1: index [1, 1, 1, 2] does not go with [1, 2, 1, 3]")]
    fn another_size_elsewhere_is_refused() {
        let tape = Tape::<f64>::new();
        tape.leaf(Tensor::zeros(Shape::new(1, 2, 1, 3))).gather(1, &Tensor::zeros(Shape::new(1, 1, 1, 2)));
    }

    #[test]
    #[should_panic(expected = "gather along axis 3 of [1, 1, 1, 2]: entry 1 of the index is 2; the rule: whole, from 0, below 2")]
    fn index_past_the_end_is_refused() {
        Tape::new().leaf(row(&[1.0, 2.0])).gather(3, &row(&[0.0, 2.0]));
    }

    #[test]
    #[should_panic(expected = "entry 0 of the index is 0.5; the rule: whole")]
    fn fractional_index_is_refused() {
        Tape::new().leaf(row(&[1.0, 2.0])).gather(3, &row(&[0.5]));
    }

    #[test]
    #[should_panic(expected = "entry 0 of the index is NaN; the rule: whole")]
    fn nan_index_is_refused() {
        Tape::new().leaf(row(&[1.0, 2.0])).gather(3, &row(&[f64::NAN]));
    }

    /// Random positions along `axis`, `count` for each line.
    fn index(seed: u64, shape: Shape, axis: usize, count: usize) -> Tensor<f64> {
        let positions = random::<f64>(seed ^ 5, shape.with_axis(axis, count), 0.0, shape.0[axis] as f64);
        Tensor::from_vec(positions.shape(), positions.data().iter().map(|x| x.floor()).collect())
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn every_entry_arrives_at_its_place(
            shape in testing::shapes(), axis in 0..4usize, count in 1..4usize, seed in any::<u64>()
        ) {
            let x: Tensor<f64> = random(seed, shape, -2.0, 2.0);
            let index = index(seed, shape, axis, count);
            let want = Tensor::from_fn(index.shape(), |n, c, h, w| {
                let mut at = [n, c, h, w];
                at[axis] = index.at(n, c, h, w) as usize;
                x.at(at[0], at[1], at[2], at[3])
            });
            prop_assert_eq!(Tape::new().leaf(x).gather(axis, &index).value(), want);
        }

        #[test]
        fn gradient_matches_finite_differences(
            shape in testing::shapes(), axis in 0..4usize, count in 1..4usize, seed in any::<u64>()
        ) {
            let index = index(seed, shape, axis, count);
            testing::check(&[random(seed, shape, -2.0, 2.0)], |v| v[0].gather(axis, &index));
        }

        #[test]
        fn adjoint_law_holds(shape in testing::shapes(), axis in 0..4usize, count in 1..4usize, seed in any::<u64>()) {
            let index = index(seed, shape, axis, count);
            testing::check_adjoint(shape, seed, |x| x.gather(axis, &index));
        }
    }
}
