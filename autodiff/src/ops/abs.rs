//! `y = |x|`. Vector-Jacobian product: `g sign(x)`, and 0 at the kink `x = 0`. Keeps: the input. NaN stays NaN.

use super::{kernel, unary};
use crate::proof::{Number, Plain, Proof, Twin};
use crate::{Scalar, Var};

fn forward<T: Scalar>(x: &[T], y: &mut [T]) {
    kernel::map(y, x, |x| x.abs());
}

fn backward<T: Scalar>(x: &[T], grad_y: &[T], grad_x: &mut [T]) {
    kernel::zip(grad_x, x, grad_y, |x, g| {
        if x > T::ZERO {
            g
        } else if x < T::ZERO {
            -g
        } else {
            T::ZERO
        }
    });
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Absolute value of every entry.
    ///
    /// **Gradient**: `g sign(x)`; 0 at `x = 0`.
    pub fn abs(self) -> Var<'t, T> {
        unary::keep_input("abs", self, forward, backward)
    }
}

#[derive(Clone, Copy, Debug)]
struct Abs;

impl Twin for Abs {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].abs()
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        x[0].map(|x| if x.value() < 0.0 { -x } else { x })
    }
}

pub(crate) fn proof() -> Proof {
    Proof::unary("abs", Abs, [-2.0, 2.0], &[0.0])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random_away, slopes, values};

    #[test]
    fn values_and_slopes_are_known() {
        let x = [-2.5, 0.0, 4.0];
        close(&values(&x, |x| x.abs()), &[2.5, 0.0, 4.0]);
        close(&slopes(&x, |x| x.abs()), &[-1.0, 0.0, 1.0]);
    }

    #[test]
    fn nan_is_not_hidden() {
        assert!(values(&[f64::NAN], |x| x.abs())[0].is_nan());
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), seed in any::<u64>()) {
            let x = random_away(seed, shape, -2.0, 2.0, &[0.0]);
            testing::check(&[x], |v| v[0].abs());
        }
    }
}
