//! `y = Σ x` over the axes where the wanted shape has size 1. Vector-Jacobian product: `g` repeated along those axes.
//! Linear, the transpose of `broadcast_to`. Keeps: nothing. Sums are taken in `f64` in a fixed order.

use super::reduce;
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, some_axes};
use crate::{Scalar, Shape, Var};

impl<'t, T: Scalar> Var<'t, T> {
    /// Sum over the axes where `shape` has size 1; the other axes must be equal.
    ///
    /// **Gradient**: `g` repeated along the summed axes.
    ///
    /// **Panics** when an axis of `shape` is neither equal nor 1.
    #[track_caller]
    pub fn sum_to(self, shape: Shape) -> Var<'t, T> {
        reduce::record("sum_to", self, shape, 1.0)
    }
}

#[derive(Clone, Copy, Debug)]
struct SumTo(Shape);

impl Twin for SumTo {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].sum_to(self.0)
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        x[0].summed(self.0)
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("sum_to");
    let pairs = some_axes(&mut draw);
    Proof::new("sum_to", pairs.into_iter().map(|(large, small)| Case::new(SumTo(small), [draw.uniform(large, -2.0, 2.0)])))
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
        let y = x.sum_to(Shape::new(1, 2, 1, 1));
        close(y.value().data(), &[306.0, 366.0]);
        let weights = tape.constant(Tensor::from_vec(y.shape(), vec![2.0, 5.0]));
        let grads = tape.backward(y.mul(weights).sum());
        close(grads.wrt(x).data(), &[2.0, 2.0, 2.0, 5.0, 5.0, 5.0, 2.0, 2.0, 2.0, 5.0, 5.0, 5.0]);
    }

    #[test]
    #[should_panic(expected = "sum_to: [1, 2, 1, 1] does not go with [1, 3, 1, 1]")]
    fn neither_equal_nor_one_is_refused() {
        let tape = Tape::<f64>::new();
        tape.leaf(Tensor::zeros(Shape::new(1, 3, 1, 1))).sum_to(Shape::new(1, 2, 1, 1));
    }

    fn smaller(shape: Shape, keep: [bool; 4]) -> Shape {
        Shape(std::array::from_fn(|i| if keep[i] { shape.0[i] } else { 1 }))
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), keep in any::<[bool; 4]>(), seed in any::<u64>()) {
            testing::check(&[random(seed, shape, -2.0, 2.0)], |v| v[0].sum_to(smaller(shape, keep)));
        }

        #[test]
        fn adjoint_law_holds(shape in testing::shapes(), keep in any::<[bool; 4]>(), seed in any::<u64>()) {
            testing::check_adjoint(shape, seed, |x| x.sum_to(smaller(shape, keep)));
        }
    }
}
