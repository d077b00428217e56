//! `y = max(x, 0)`. Vector-Jacobian product: `g` where `y > 0`, else 0; at the kink `x = 0` it is 0. Keeps: the output.
//!
//! NaN stays NaN, in the value and in the gradient.

use super::{kernel, unary};
use crate::activation::{self, Activate};
use crate::proof::{Number, Plain, Proof, Twin};
use crate::{Scalar, Var};

fn forward<T: Scalar>(x: &[T], y: &mut [T]) {
    kernel::map(y, x, |x| activation::Relu.of(x));
}

fn backward<T: Scalar>(y: &[T], grad_y: &[T], grad_x: &mut [T]) {
    kernel::zip(grad_x, y, grad_y, |y, g| activation::Relu.back(y, g));
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Positive part of every entry.
    ///
    /// **Gradient**: `g` where `x > 0`, else 0; 0 at `x = 0`.
    pub fn relu(self) -> Var<'t, T> {
        unary::keep_output("relu", self, forward, backward)
    }
}

#[derive(Clone, Copy, Debug)]
struct Relu;

impl Twin for Relu {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].relu()
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        x[0].map(|x| if x.value() > 0.0 { x } else { N::zero() })
    }
}

pub(crate) fn proof() -> Proof {
    Proof::unary("relu", Relu, [-2.0, 2.0], &[0.0])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random_away, slopes, values};

    #[test]
    fn values_and_slopes_are_known() {
        let x = [-1.5, 0.0, 2.0];
        close(&values(&x, |x| x.relu()), &[0.0, 0.0, 2.0]);
        close(&slopes(&x, |x| x.relu()), &[0.0, 0.0, 1.0]);
    }

    #[test]
    fn nan_is_not_hidden() {
        assert!(values(&[f64::NAN], |x| x.relu())[0].is_nan());
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), seed in any::<u64>()) {
            let x = random_away(seed, shape, -2.0, 2.0, &[0.0]);
            testing::check(&[x], |v| v[0].relu());
        }
    }
}
