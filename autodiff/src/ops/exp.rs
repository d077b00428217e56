//! `y = eˣ`. Vector-Jacobian product: `g y`. No kinks. Keeps: the output. Overflow gives `∞`, underflow 0.

use super::{kernel, unary};
use crate::proof::{Number, Plain, Proof, Twin};
use crate::{Scalar, Var};

fn forward<T: Scalar>(x: &[T], y: &mut [T]) {
    kernel::map(y, x, |x| x.exp());
}

fn backward<T: Scalar>(y: &[T], grad_y: &[T], grad_x: &mut [T]) {
    kernel::zip(grad_x, y, grad_y, |y, g| g * y);
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Exponential of every entry.
    ///
    /// **Gradient**: `g eˣ`.
    pub fn exp(self) -> Var<'t, T> {
        unary::keep_output("exp", self, forward, backward)
    }
}

#[derive(Clone, Copy, Debug)]
struct Exp;

impl Twin for Exp {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].exp()
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        x[0].map(N::exp)
    }
}

pub(crate) fn proof() -> Proof {
    Proof::unary("exp", Exp, [-2.0, 2.0], &[])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random, slopes, values};

    #[test]
    fn values_and_slopes_are_known() {
        let e = std::f64::consts::E;
        close(&values(&[0.0, 1.0, -2.0, 800.0], |x| x.exp()), &[1.0, e, 1.0 / (e * e), f64::INFINITY]);
        close(&slopes(&[0.0, 1.0, -2.0], |x| x.exp()), &[1.0, e, 1.0 / (e * e)]);
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), seed in any::<u64>()) {
            let x = random(seed, shape, -2.0, 2.0);
            testing::check(&[x], |v| v[0].exp());
        }
    }
}
