//! `y = √x`. Vector-Jacobian product: `g / (2 y)`. Keeps: the output.
//!
//! Domain: `x >= 0`; a negative entry gives NaN, which is not hidden. At `x = 0` the derivative is infinite and
//! the product is the limit `g · ∞`: infinite for `g ≠ 0` and NaN for `g = 0`. Where zero can occur, guard the
//! argument first: `x.add_scalar(eps).sqrt()`, `x.clamp(eps, f64::INFINITY).sqrt()`, or `select` a positive constant.

use super::{kernel, unary};
use crate::proof::{Number, Plain, Proof, Twin};
use crate::{Scalar, Var};

fn forward<T: Scalar>(x: &[T], y: &mut [T]) {
    kernel::map(y, x, |x| x.sqrt());
}

fn backward<T: Scalar>(y: &[T], grad_y: &[T], grad_x: &mut [T]) {
    kernel::zip(grad_x, y, grad_y, |y, g| g * (T::from_f64(0.5) / y));
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Square root of every entry.
    ///
    /// **Domain**: `x >= 0`, NaN below. **Gradient**: `g / (2 √x)`, infinite at 0 (and NaN there when `g` is 0):
    /// guard the argument, as in `x.add_scalar(eps).sqrt()`, where zero can occur.
    pub fn sqrt(self) -> Var<'t, T> {
        unary::keep_output("sqrt", self, forward, backward)
    }
}

#[derive(Clone, Copy, Debug)]
struct Sqrt;

impl Twin for Sqrt {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].sqrt()
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        x[0].map(N::sqrt)
    }
}

pub(crate) fn proof() -> Proof {
    Proof::unary("sqrt", Sqrt, [0.1, 3.0], &[])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random, slopes, values};

    #[test]
    fn values_and_slopes_are_known() {
        let x = [0.25, 1.0, 9.0];
        close(&values(&x, |x| x.sqrt()), &[0.5, 1.0, 3.0]);
        close(&slopes(&x, |x| x.sqrt()), &[1.0, 0.5, 1.0 / 6.0]);
    }

    #[test]
    fn slope_at_zero_is_infinite_and_the_guarded_form_is_finite() {
        close(&slopes(&[0.0], |x| x.sqrt()), &[f64::INFINITY]);
        close(&slopes(&[0.0], |x| x.add_scalar(1e-4).sqrt()), &[50.0]);
        assert!(slopes(&[0.0], |x| x.sqrt().scale(0.0))[0].is_nan());
    }

    #[test]
    fn negative_argument_gives_nan() {
        assert!(values(&[-1e-9], |x| x.sqrt())[0].is_nan());
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), seed in any::<u64>()) {
            let x = random(seed, shape, 0.1, 4.0);
            testing::check(&[x], |v| v[0].sqrt());
        }
    }
}
