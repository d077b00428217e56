//! `y = -x`. Vector-Jacobian product: `-g`. Linear. Keeps: nothing.

use super::{kernel, unary};
use crate::proof::{Number, Plain, Proof, Twin};
use crate::{Scalar, Var};

fn forward<T: Scalar>(x: &[T], y: &mut [T]) {
    kernel::map(y, x, |x| -x);
}

fn backward<T: Scalar>(grad_y: &[T], grad_x: &mut [T]) {
    kernel::map(grad_x, grad_y, |g| -g);
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Every entry with the opposite sign; also written `-x`.
    ///
    /// **Gradient**: `-g`.
    #[allow(clippy::should_implement_trait)] // implemented below; the method needs no import
    pub fn neg(self) -> Var<'t, T> {
        unary::keep_nothing("neg", self, forward, backward)
    }
}

impl<'t, T: Scalar> std::ops::Neg for Var<'t, T> {
    type Output = Var<'t, T>;

    fn neg(self) -> Var<'t, T> {
        Var::neg(self)
    }
}

#[derive(Clone, Copy, Debug)]
struct Neg;

impl Twin for Neg {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].neg()
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        x[0].map(|x| -x)
    }
}

pub(crate) fn proof() -> Proof {
    Proof::unary("neg", Neg, [-2.0, 2.0], &[])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random, slopes, values};

    #[test]
    fn values_and_slopes_are_known() {
        let x = [-3.0, 0.0, 0.5];
        close(&values(&x, |x| x.neg()), &[3.0, 0.0, -0.5]);
        close(&values(&x, |x| -x), &[3.0, 0.0, -0.5]);
        close(&slopes(&x, |x| -x), &[-1.0, -1.0, -1.0]);
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn adjoint_law_holds(shape in testing::shapes(), seed in any::<u64>()) {
            testing::check_adjoint(shape, seed, |x| x.neg());
        }
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), seed in any::<u64>()) {
            let x = random(seed, shape, -2.0, 2.0);
            testing::check(&[x], |v| v[0].neg());
        }
    }
}
