//! `y[n] = Σ over c, h, w of x`: one sum for each sample. Vector-Jacobian product: `g[n]` to every entry of the sample.
//! Linear. Keeps: nothing. Sums are taken in `f64` in a fixed order.

use super::reduce;
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, shapes};
use crate::{Scalar, Shape, Var};

impl<'t, T: Scalar> Var<'t, T> {
    /// Sum over channels, rows and columns, shape `[n, 1, 1, 1]`.
    ///
    /// **Gradient**: `g` to every entry of the sample.
    pub fn sum_chw(self) -> Var<'t, T> {
        let shape = self.shape();
        reduce::record("sum_chw", self, Shape::new(shape.n(), 1, 1, 1), 1.0)
    }
}

#[derive(Clone, Copy, Debug)]
struct SumChw;

impl Twin for SumChw {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].sum_chw()
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let to = Shape::new(x[0].shape.n(), 1, 1, 1);
        x[0].summed(to)
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("sum_chw");
    let shapes = shapes(&mut draw);
    Proof::new("sum_chw", shapes.into_iter().map(|shape| Case::new(SumChw, [draw.uniform(shape, -2.0, 2.0)])))
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
        let y = x.sum_chw();
        assert_eq!(y.shape(), Shape::new(2, 1, 1, 1));
        close(y.value().data(), &[63.0, 663.0]);
        let weights = tape.constant(Tensor::from_vec(y.shape(), vec![2.0, 3.0]));
        close(tape.backward(y.mul(weights).sum()).wrt(x).data(), &[2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 3.0, 3.0, 3.0, 3.0, 3.0, 3.0]);
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), seed in any::<u64>()) {
            testing::check(&[random(seed, shape, -2.0, 2.0)], |v| v[0].sum_chw());
        }

        #[test]
        fn adjoint_law_holds(shape in testing::shapes(), seed in any::<u64>()) {
            testing::check_adjoint(shape, seed, |x| x.sum_chw());
        }
    }
}
