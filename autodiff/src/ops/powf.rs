//! `y = xᵖ` with a constant exponent `p ≠ 0`. Vector-Jacobian product: `g p xᵖ⁻¹`. Keeps: the input.
//!
//! Domain: `x > 0`. At `x = 0` the slope is 0 for `p > 1`, 1 for `p = 1`, and infinite for `p < 1` (NaN where `g = 0`): add a
//! positive number first, as the robust penalties `(x + ε)ᵖ` do. A negative entry gives NaN, which is not hidden, unless `p` is a
//! whole number. NaN stays NaN, which is why the exponent 0 is refused.

use super::{kernel, unary};
use crate::proof::{Number, Plain, Proof, Twin};
use crate::{Scalar, Var};

fn forward<T: Scalar>(x: &[T], exponent: T, y: &mut [T]) {
    kernel::map(y, x, |x| x.powf(exponent));
}

fn backward<T: Scalar>(x: &[T], exponent: T, grad_y: &[T], grad_x: &mut [T]) {
    kernel::zip(grad_x, x, grad_y, |x, g| g * (exponent * x.powf(exponent - T::ONE)));
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Every entry to the constant power `exponent` (rounded to `T` first).
    ///
    /// **Shapes**: any to the same. **Domain**: `x > 0`, or any `x` where the exponent is a whole number.
    ///
    /// **Gradient**: `g p xᵖ⁻¹`; infinite at `x = 0` for exponents below 1.
    ///
    /// **Panics** unless `exponent` is finite and not 0.
    #[track_caller]
    pub fn powf(self, exponent: f64) -> Var<'t, T> {
        let power = T::from_f64(exponent);
        assert!(
            power.is_finite() && power != T::ZERO,
            "powf: exponent {exponent} for shape {}; the rule: finite and not 0",
            self.shape()
        );
        unary::keep_input("powf", self, |x, y| forward(x, power, y), move |x, g, out| backward(x, power, g, out))
    }
}

#[derive(Clone, Copy, Debug)]
struct Powf(f64);

impl Twin for Powf {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].powf(self.0)
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        x[0].map(|x| x.powf(self.0))
    }
}

pub(crate) fn proof() -> Proof {
    Proof::unary("powf", Powf(0.5), [0.2, 3.0], &[])
        .and(Proof::unary("powf", Powf(2.0), [-2.0, 2.0], &[0.0]))
        .and(Proof::unary("powf", Powf(-1.5), [0.3, 2.0], &[]))
        .and(Proof::unary("powf", Powf(3.0), [0.2, 2.0], &[]))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random, slopes, values};

    #[test]
    fn values_and_slopes_are_known() {
        let x = [1.0, 4.0, 0.25];
        close(&values(&x, |x| x.powf(1.5)), &[1.0, 8.0, 0.125]);
        close(&slopes(&x, |x| x.powf(1.5)), &[1.5, 3.0, 0.75]);
        close(&values(&x, |x| x.powf(-0.5)), &[1.0, 0.5, 2.0]);
        close(&slopes(&x, |x| x.powf(-0.5)), &[-0.5, -0.0625, -4.0]);
        close(&values(&[-2.0], |x| x.powf(3.0)), &[-8.0]);
        close(&slopes(&[-2.0], |x| x.powf(3.0)), &[12.0]);
    }

    #[test]
    fn slope_at_zero_depends_on_the_exponent() {
        close(&slopes(&[0.0], |x| x.powf(1.5)), &[0.0]);
        close(&slopes(&[0.0], |x| x.powf(1.0)), &[1.0]);
        close(&slopes(&[0.0], |x| x.powf(0.4)), &[f64::INFINITY]);
        close(&slopes(&[0.0], |x| x.add_scalar(1.0).powf(0.4)), &[0.4]);
    }

    #[test]
    fn nan_and_roots_of_negative_numbers_are_not_hidden() {
        assert!(values(&[f64::NAN, -1.0], |x| x.powf(0.5)).iter().all(|y| y.is_nan()));
    }

    #[test]
    #[should_panic(expected = "powf: exponent 0 for shape [1, 1, 1, 1]; the rule: finite and not 0")]
    fn exponent_zero_is_refused() {
        values(&[f64::NAN], |x| x.powf(0.0));
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(
            shape in testing::shapes(), size in 0.2..3.0_f64, negative in any::<bool>(), seed in any::<u64>()
        ) {
            let exponent = if negative { -size } else { size };
            testing::check(&[random(seed, shape, 0.5, 2.5)], |v| v[0].powf(exponent));
        }
    }
}
