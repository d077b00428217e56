//! `y = 1 / (1 + e⁻ˣ)`, in (0, 1). Vector-Jacobian product: `g y (1 - y)`. No kinks. Keeps: the output.
//!
//! Computed from `e^(-|x|)`, so that no argument overflows: far out the value is 0 or 1 and the slope 0.

use super::{kernel, unary};
use crate::proof::{Number, Plain, Proof, Twin};
use crate::{Scalar, Var};

/// The logistic function of one number.
#[inline(always)]
pub(crate) fn logistic<T: Scalar>(x: T) -> T {
    let small = (-x.abs()).exp();
    let upper = T::ONE / (T::ONE + small);
    if x < T::ZERO { small * upper } else { upper }
}

fn forward<T: Scalar>(x: &[T], y: &mut [T]) {
    kernel::map(y, x, logistic);
}

fn backward<T: Scalar>(y: &[T], grad_y: &[T], grad_x: &mut [T]) {
    kernel::zip(grad_x, y, grad_y, |y, g| g * y * (T::ONE - y));
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Logistic function of every entry.
    ///
    /// **Gradient**: `g y (1 - y)` with the output `y`.
    pub fn sigmoid(self) -> Var<'t, T> {
        unary::keep_output("sigmoid", self, forward, backward)
    }
}

#[derive(Clone, Copy, Debug)]
struct Sigmoid;

impl Twin for Sigmoid {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].sigmoid()
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        x[0].map(|x| N::one() / (N::one() + (-x).exp()))
    }
}

pub(crate) fn proof() -> Proof {
    Proof::unary("sigmoid", Sigmoid, [-4.0, 4.0], &[])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random, slopes, values};

    #[test]
    fn values_and_slopes_are_known() {
        let third = 3.0_f64.ln();
        close(&values(&[0.0, third, -third], |x| x.sigmoid()), &[0.5, 0.75, 0.25]);
        close(&slopes(&[0.0, third, -third], |x| x.sigmoid()), &[0.25, 0.1875, 0.1875]);
    }

    #[test]
    fn far_arguments_saturate_without_nan() {
        close(&values(&[-1e4, 1e4], |x| x.sigmoid()), &[0.0, 1.0]);
        close(&slopes(&[-1e4, 1e4], |x| x.sigmoid()), &[0.0, 0.0]);
        assert!(values(&[f64::NAN], |x| x.sigmoid())[0].is_nan());
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), seed in any::<u64>()) {
            let x = random(seed, shape, -3.0, 3.0);
            testing::check(&[x], |v| v[0].sigmoid());
        }
    }
}
