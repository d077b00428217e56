//! `y = max x` along one axis, with the position of the maximum. Vector-Jacobian product: `g` to the first maximum of each line,
//! 0 to the rest, so at a tie the first takes all. Keeps: the positions.
//!
//! A line with NaN gives NaN, and the position and the gradient are those of its first NaN.

use super::extremum::{self, Extremum};
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, shapes};
use crate::{Scalar, Var};

impl<'t, T: Scalar> Var<'t, T> {
    /// The largest entry along `axis` (0 to 3 for n, c, h, w) and its position.
    ///
    /// **Shapes**: any to the same with size 1 along `axis`, for the values and for the index.
    ///
    /// **Gradient**: `g` to the first maximum of each line, 0 to the others.
    ///
    /// **Panics** for an axis above 3 or an empty one.
    #[track_caller]
    pub fn max_axis(self, axis: usize) -> Extremum<'t, T> {
        extremum::record("max_axis", self, axis, T::NEG_INFINITY, |x, best| x > best)
    }
}

#[derive(Clone, Copy, Debug)]
struct MaxAxis(usize);

impl Twin for MaxAxis {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].max_axis(self.0).values
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let better = |best: N, x: N| if x.value() > best.value() { x } else { best };
        let extreme = |i| x[0].line(i, self.0).into_iter().reduce(better).expect("no empty line");
        Plain::from_fn(x[0].shape.with_axis(self.0, 1), extreme)
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("max_axis");
    let mut cases = Vec::new();
    for (i, shape) in shapes(&mut draw).into_iter().enumerate() {
        let x = draw.distinct(shape);
        let axes = if shape.len() > 500 { i % 4..i % 4 + 1 } else { 0..4 };
        cases.extend(axes.map(|axis| Case::new(MaxAxis(axis), [x.clone()])));
    }
    Proof::new("max_axis", cases)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, distinct, row};
    use crate::{Shape, Tape, Tensor};

    #[test]
    fn values_positions_and_gradient_are_known() {
        let tape = Tape::new();
        let x = tape.leaf(Tensor::from_vec(Shape::new(1, 3, 1, 2), vec![1.0, 9.0, 7.0, -2.0, 3.0, 4.0]));
        let y = x.max_axis(1);
        assert_eq!(y.index, Tensor::from_vec(Shape::new(1, 1, 1, 2), vec![1.0, 0.0]));
        close(y.values.value().data(), &[7.0, 9.0]);
        let loss = y.values.mul(tape.constant(row(&[2.0, 5.0]))).sum();
        close(tape.backward(loss).wrt(x).data(), &[0.0, 5.0, 2.0, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn the_first_of_equal_maxima_takes_the_gradient() {
        let tape = Tape::new();
        let x = tape.leaf(row(&[1.0, 4.0, 4.0]));
        let y = x.max_axis(3);
        close(y.index.data(), &[1.0]);
        close(tape.backward(y.values).wrt(x).data(), &[0.0, 1.0, 0.0]);
        close(tape.leaf(row(&[f64::NEG_INFINITY; 2])).max_axis(3).index.data(), &[0.0]);
    }

    #[test]
    fn the_first_nan_is_not_hidden() {
        let tape = Tape::new();
        let x = tape.leaf(row(&[1.0, f64::NAN, 5.0, f64::NAN]));
        let y = x.max_axis(3);
        assert!(y.values.value().item().is_nan());
        close(y.index.data(), &[1.0]);
        close(tape.backward(y.values).wrt(x).data(), &[0.0, 1.0, 0.0, 0.0]);
    }

    #[test]
    #[should_panic(expected = "max_axis: axis 4 of shape [1, 1, 1, 1]")]
    fn axis_four_is_refused() {
        Tape::<f64>::new().leaf(row(&[1.0])).max_axis(4);
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), axis in 0..4usize, seed in any::<u64>()) {
            testing::check(&[distinct(seed, shape)], |v| v[0].max_axis(axis).values);
        }

        #[test]
        fn no_entry_is_larger(shape in testing::shapes(), axis in 0..4usize, seed in any::<u64>()) {
            let tape = Tape::<f64>::new();
            let x = tape.constant(distinct(seed, shape));
            let most = x.max_axis(axis);
            prop_assert_eq!(x.gather(axis, &most.index).value(), most.values.value());
            let margin = most.values.broadcast_to(shape).sub(x).value();
            prop_assert!(margin.data().iter().all(|&m| m >= 0.0));
        }
    }
}
