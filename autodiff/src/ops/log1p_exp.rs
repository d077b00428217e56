//! `y = ln(1 + eˣ)`, a smooth positive part. Vector-Jacobian product: `g / (1 + e⁻ˣ)`. No kinks. Keeps: the input.
//!
//! Computed as `max(x, 0) + ln(1 + e^(-|x|))`, so that no argument overflows, and with the logarithm exact near 1, so that far
//! negative arguments give `eˣ` and not 0. NaN stays NaN.

use super::sigmoid::logistic;
use super::{kernel, unary};
use crate::proof::{Number, Plain, Proof, Twin};
use crate::{Scalar, Var};

fn forward<T: Scalar>(x: &[T], y: &mut [T]) {
    kernel::map(y, x, |x| {
        let rest = (-x.abs()).exp().ln_1p();
        if x > T::ZERO { x + rest } else { rest }
    });
}

fn backward<T: Scalar>(x: &[T], grad_y: &[T], grad_x: &mut [T]) {
    kernel::zip(grad_x, x, grad_y, |x, g| g * logistic(x));
}

impl<'t, T: Scalar> Var<'t, T> {
    /// `ln(1 + eˣ)` of every entry: the cross entropy of a logit against the target 0; of `-x` against the target 1.
    ///
    /// **Shapes**: any to the same.
    ///
    /// **Gradient**: `g / (1 + e⁻ˣ)`; 1/2 at `x = 0`.
    pub fn log1p_exp(self) -> Var<'t, T> {
        unary::keep_input("log1p_exp", self, forward, backward)
    }
}

#[derive(Clone, Copy, Debug)]
struct Log1pExp;

impl Twin for Log1pExp {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].log1p_exp()
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        x[0].map(|x| x.exp().ln_1p())
    }
}

pub(crate) fn proof() -> Proof {
    Proof::unary("log1p_exp", Log1pExp, [-3.0, 3.0], &[])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random, slopes, values};

    #[test]
    fn values_and_slopes_are_known() {
        let x = [0.0, 3.0_f64.ln(), -3.0_f64.ln()];
        close(&values(&x, |x| x.log1p_exp()), &[2.0_f64.ln(), 4.0_f64.ln(), (4.0_f64 / 3.0).ln()]);
        close(&slopes(&x, |x| x.log1p_exp()), &[0.5, 0.75, 0.25]);
    }

    #[test]
    fn far_arguments_neither_overflow_nor_vanish() {
        close(&values(&[-1e4, 1e4], |x| x.log1p_exp()), &[0.0, 1e4]);
        close(&slopes(&[-1e4, 1e4], |x| x.log1p_exp()), &[0.0, 1.0]);
        let small = (-50.0_f64).exp();
        assert!((values(&[-50.0], |x| x.log1p_exp())[0] / small - 1.0).abs() < 1e-15);
        assert!((slopes(&[-50.0], |x| x.log1p_exp())[0] / small - 1.0).abs() < 1e-15);
    }

    #[test]
    fn nan_is_not_hidden() {
        assert!(values(&[f64::NAN], |x| x.log1p_exp())[0].is_nan());
        assert!(slopes(&[f64::NAN], |x| x.log1p_exp())[0].is_nan());
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), seed in any::<u64>()) {
            testing::check(&[random(seed, shape, -3.0, 3.0)], |v| v[0].log1p_exp());
        }
    }
}
