//! `y = (Σ x) / count` over everything. Vector-Jacobian product: `g / count` to every entry. Linear. Keeps: nothing.
//!
//! The sum is taken in `f64`, in pieces of fixed size that are added in order. The mean of no entries is NaN.

use super::reduce;
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, shapes};
use crate::{Scalar, Shape, Var};

impl<'t, T: Scalar> Var<'t, T> {
    /// Mean of all entries, shape `[1, 1, 1, 1]`.
    ///
    /// **Gradient**: `g / count` to every entry.
    pub fn mean(self) -> Var<'t, T> {
        let shape = self.shape();
        reduce::record("mean", self, Shape::SCALAR, shape.len() as f64)
    }
}

#[derive(Clone, Copy, Debug)]
struct Mean;

impl Twin for Mean {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].mean()
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let to = Shape::SCALAR;
        let terms = x[0].shape.len() as f64 / to.len() as f64;
        x[0].summed(to).map(|sum| sum / N::constant(terms))
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("mean");
    let shapes = shapes(&mut draw);
    Proof::new("mean", shapes.into_iter().map(|shape| Case::new(Mean, [draw.uniform(shape, -2.0, 2.0)])))
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
        let y = x.mean();
        assert_eq!(y.shape(), Shape::SCALAR);
        close(y.value().data(), &[60.5]);
        let weights = tape.constant(Tensor::from_vec(y.shape(), vec![6.0]));
        close(tape.backward(y.mul(weights)).wrt(x).data(), &[0.5; 12]);
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), seed in any::<u64>()) {
            testing::check(&[random(seed, shape, -2.0, 2.0)], |v| v[0].mean());
        }

        #[test]
        fn adjoint_law_holds(shape in testing::shapes(), seed in any::<u64>()) {
            testing::check_adjoint(shape, seed, |x| x.mean());
        }
    }
}
