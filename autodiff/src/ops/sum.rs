//! `y = Σ x` over everything. Vector-Jacobian product: `g` to every entry. Linear. Keeps: nothing.
//!
//! The sum is taken in `f64`, in pieces of fixed size that are added in order.

use super::reduce;
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, shapes};
use crate::{Scalar, Shape, Var};

impl<'t, T: Scalar> Var<'t, T> {
    /// Sum of all entries, shape `[1, 1, 1, 1]`.
    ///
    /// **Gradient**: `g` to every entry.
    pub fn sum(self) -> Var<'t, T> {
        reduce::record("sum", self, Shape::SCALAR, 1.0)
    }
}

#[derive(Clone, Copy, Debug)]
struct Sum;

impl Twin for Sum {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].sum()
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let to = Shape::SCALAR;
        x[0].summed(to)
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("sum");
    let shapes = shapes(&mut draw);
    Proof::new("sum", shapes.into_iter().map(|shape| Case::new(Sum, [draw.uniform(shape, -2.0, 2.0)])))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random};
    use crate::{Shape, Tape, Tensor};

    #[test]
    fn values_and_gradient_are_known() {
        let tape = Tape::new();
        let x = tape.leaf(Tensor::from_fn(Shape::new(2, 3, 1, 2), |n, c, _, w| (100 * n + 10 * c + w) as f64));
        let y = x.sum();
        assert_eq!(y.shape(), Shape::SCALAR);
        close(y.value().data(), &[726.0]);
        let weights = tape.constant(Tensor::from_vec(y.shape(), vec![2.0]));
        close(tape.backward(y.mul(weights)).wrt(x).data(), &[2.0; 12]);
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), seed in any::<u64>()) {
            testing::check(&[random(seed, shape, -2.0, 2.0)], |v| v[0].sum());
        }

        #[test]
        fn adjoint_law_holds(shape in testing::shapes(), seed in any::<u64>()) {
            testing::check_adjoint(shape, seed, |x| x.sum());
        }
    }
}
