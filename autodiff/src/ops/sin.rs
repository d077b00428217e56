//! `y = sin x`, `x` in radians. Vector-Jacobian product: `g cos x`. No kinks. Keeps: the input.

use super::{kernel, unary};
use crate::proof::{Number, Plain, Proof, Twin};
use crate::{Scalar, Var};

fn forward<T: Scalar>(x: &[T], y: &mut [T]) {
    kernel::map(y, x, |x| x.sin());
}

fn backward<T: Scalar>(x: &[T], grad_y: &[T], grad_x: &mut [T]) {
    kernel::zip(grad_x, x, grad_y, |x, g| g * x.cos());
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Sine of every entry (radians).
    ///
    /// **Gradient**: `g cos x`.
    pub fn sin(self) -> Var<'t, T> {
        unary::keep_input("sin", self, forward, backward)
    }
}

#[derive(Clone, Copy, Debug)]
struct Sin;

impl Twin for Sin {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].sin()
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        x[0].map(N::sin)
    }
}

pub(crate) fn proof() -> Proof {
    Proof::unary("sin", Sin, [-4.0, 4.0], &[])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random, slopes, values};

    #[test]
    fn values_and_slopes_are_known() {
        let pi = std::f64::consts::PI;
        close(&values(&[0.0, pi / 6.0, -pi / 2.0], |x| x.sin()), &[0.0, 0.5, -1.0]);
        close(&slopes(&[0.0, pi / 3.0, pi], |x| x.sin()), &[1.0, 0.5, -1.0]);
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), seed in any::<u64>()) {
            let x = random(seed, shape, -3.0, 3.0);
            testing::check(&[x], |v| v[0].sin());
        }
    }
}
