//! `y = min x` along one axis, with the position of the minimum. Vector-Jacobian product: `g` to the first minimum of each line,
//! 0 to the rest, so at a tie the first takes all. Keeps: the positions.
//!
//! A line with NaN gives NaN, and the position and the gradient are those of its first NaN.

use super::extremum::{self, Extremum};
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, shapes};
use crate::{Scalar, Var};

impl<'t, T: Scalar> Var<'t, T> {
    /// The smallest entry along `axis` (0 to 3 for n, c, h, w) and its position, as for the per-pixel minimum over candidates
    /// whose companions are then picked by [`Var::gather`].
    ///
    /// **Shapes**: any to the same with size 1 along `axis`, for the values and for the index.
    ///
    /// **Gradient**: `g` to the first minimum of each line, 0 to the others.
    ///
    /// **Panics** for an axis above 3.
    #[track_caller]
    pub fn min_axis(self, axis: usize) -> Extremum<'t, T> {
        extremum::record("min_axis", self, axis, -T::NEG_INFINITY, |x, best| x < best)
    }
}

#[derive(Clone, Copy, Debug)]
struct MinAxis(usize);

impl Twin for MinAxis {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].min_axis(self.0).values
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let better = |best: N, x: N| if x.value() < best.value() { x } else { best };
        let extreme = |i| x[0].line(i, self.0).into_iter().reduce(better).expect("no empty line");
        Plain::from_fn(x[0].shape.with_axis(self.0, 1), extreme)
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("min_axis");
    let mut cases = Vec::new();
    for (i, shape) in shapes(&mut draw).into_iter().enumerate() {
        let x = draw.distinct(shape);
        let axes = if shape.len() > 500 { i % 4..i % 4 + 1 } else { 0..4 };
        cases.extend(axes.map(|axis| Case::new(MinAxis(axis), [x.clone()])));
    }
    Proof::new("min_axis", cases)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, distinct, row};
    use crate::{Shape, Tape, Tensor};

    #[test]
    fn values_positions_and_gradient_are_known() {
        let tape = Tape::new();
        let x = tape.leaf(Tensor::from_vec(Shape::new(2, 1, 3, 1), vec![5.0, 1.0, 3.0, -2.0, 0.0, -1.0]));
        let y = x.min_axis(2);
        assert_eq!(y.index, Tensor::from_vec(Shape::new(2, 1, 1, 1), vec![1.0, 0.0]));
        close(y.values.value().data(), &[1.0, -2.0]);
        let weights = tape.constant(Tensor::from_vec(y.index.shape(), vec![2.0, 5.0]));
        close(tape.backward(y.values.mul(weights).sum()).wrt(x).data(), &[0.0, 2.0, 0.0, 5.0, 0.0, 0.0]);
    }

    #[test]
    fn the_companions_of_the_minimum_are_picked_by_its_index() {
        let tape = Tape::new();
        let (errors, companions) = (tape.leaf(row(&[3.0, 1.0, 2.0])), tape.leaf(row(&[10.0, 20.0, 30.0])));
        let least = errors.min_axis(3);
        let y = companions.gather(3, &least.index);
        close(y.value().data(), &[20.0]);
        let grads = tape.backward(y.add(least.values));
        close(grads.wrt(companions).data(), &[0.0, 1.0, 0.0]);
        close(grads.wrt(errors).data(), &[0.0, 1.0, 0.0]);
    }

    #[test]
    fn the_first_of_equal_minima_takes_the_gradient() {
        let tape = Tape::new();
        let x = tape.leaf(row(&[4.0, 1.0, 1.0]));
        let y = x.min_axis(3);
        close(y.index.data(), &[1.0]);
        close(tape.backward(y.values).wrt(x).data(), &[0.0, 1.0, 0.0]);
        close(tape.leaf(row(&[f64::INFINITY; 2])).min_axis(3).index.data(), &[0.0]);
    }

    #[test]
    fn the_first_nan_is_not_hidden() {
        let tape = Tape::new();
        let x = tape.leaf(row(&[1.0, f64::NAN, -5.0, f64::NAN]));
        let y = x.min_axis(3);
        assert!(y.values.value().item().is_nan());
        close(y.index.data(), &[1.0]);
        close(tape.backward(y.values).wrt(x).data(), &[0.0, 1.0, 0.0, 0.0]);
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), axis in 0..4usize, seed in any::<u64>()) {
            testing::check(&[distinct(seed, shape)], |v| v[0].min_axis(axis).values);
        }

        #[test]
        fn it_is_the_negated_maximum_of_the_negated_entries(
            shape in testing::shapes(), axis in 0..4usize, seed in any::<u64>()
        ) {
            let tape = Tape::<f64>::new();
            let x = tape.constant(distinct(seed, shape));
            let (least, most) = (x.min_axis(axis), x.neg().max_axis(axis));
            prop_assert_eq!(least.index, most.index);
            prop_assert_eq!(least.values.value(), most.values.neg().value());
        }
    }
}
