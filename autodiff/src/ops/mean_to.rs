//! `y = (Σ x) / count` over the axes where the wanted shape has size 1, `count` the entries of one sum. Vector-Jacobian product:
//! `g / count` repeated along those axes. Linear. Keeps: nothing. Sums are taken in `f64` in a fixed order.

use super::reduce;
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, some_axes};
use crate::{Scalar, Shape, Var};

impl<'t, T: Scalar> Var<'t, T> {
    /// Mean over the axes where `shape` has size 1; the other axes must be equal.
    ///
    /// **Shapes**: as `shape` says; `x.shape().with_axis(axis, 1)` for the mean over one axis.
    ///
    /// **Gradient**: `g / count` repeated along the averaged axes.
    ///
    /// **Panics** when an axis of `shape` is neither equal nor 1.
    #[track_caller]
    pub fn mean_to(self, shape: Shape) -> Var<'t, T> {
        reduce::record("mean_to", self, shape, self.shape().len() as f64 / shape.len() as f64)
    }
}

#[derive(Clone, Copy, Debug)]
struct MeanTo(Shape);

impl Twin for MeanTo {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].mean_to(self.0)
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let terms = x[0].shape.len() as f64 / self.0.len() as f64;
        x[0].summed(self.0).map(|sum| sum / N::constant(terms))
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("mean_to");
    let pairs = some_axes(&mut draw);
    Proof::new("mean_to", pairs.into_iter().map(|(large, small)| Case::new(MeanTo(small), [draw.uniform(large, -2.0, 2.0)])))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random};
    use crate::{Shape, Tape, Tensor};

    #[test]
    fn values_and_gradient_are_known() {
        let tape = Tape::new();
        let x = tape.leaf(Tensor::from_fn(Shape::new(2, 2, 1, 3), |n, c, _, w| (100 * n + 10 * c + w) as f64));
        let y = x.mean_to(Shape::new(1, 2, 1, 1));
        close(y.value().data(), &[51.0, 61.0]);
        let weights = tape.constant(Tensor::from_vec(y.shape(), vec![12.0, 30.0]));
        let grads = tape.backward(y.mul(weights).sum());
        close(grads.wrt(x).data(), &[2.0, 2.0, 2.0, 5.0, 5.0, 5.0, 2.0, 2.0, 2.0, 5.0, 5.0, 5.0]);
    }

    #[test]
    #[should_panic(expected = "mean_to: [1, 2, 1, 1] does not go with [1, 3, 1, 1]")]
    fn neither_equal_nor_one_is_refused() {
        let tape = Tape::<f64>::new();
        tape.leaf(Tensor::zeros(Shape::new(1, 3, 1, 1))).mean_to(Shape::new(1, 2, 1, 1));
    }

    fn smaller(shape: Shape, keep: [bool; 4]) -> Shape {
        Shape(std::array::from_fn(|i| if keep[i] { shape.0[i] } else { 1 }))
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), keep in any::<[bool; 4]>(), seed in any::<u64>()) {
            testing::check(&[random(seed, shape, -2.0, 2.0)], |v| v[0].mean_to(smaller(shape, keep)));
        }

        #[test]
        fn adjoint_law_holds(shape in testing::shapes(), keep in any::<[bool; 4]>(), seed in any::<u64>()) {
            testing::check_adjoint(shape, seed, |x| x.mean_to(smaller(shape, keep)));
        }

        #[test]
        fn mean_of_repetitions_is_the_original(shape in testing::shapes(), keep in any::<[bool; 4]>(), seed in any::<u64>()) {
            let tape = Tape::<f64>::new();
            let small = smaller(shape, keep);
            let x = tape.constant(random(seed, small, -2.0, 2.0));
            close(x.broadcast_to(shape).mean_to(small).value().data(), x.value().data());
        }
    }
}
