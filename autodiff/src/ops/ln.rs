//! `y = ln x`. Vector-Jacobian product: `g / x`. Keeps: the input.
//!
//! Domain: `x > 0`. Zero gives `-∞` with derivative `∞`, a negative entry gives NaN; neither is hidden. Where zero can
//! occur, clamp the argument or `select` a positive constant first.

use super::{kernel, unary};
use crate::proof::{Number, Plain, Proof, Twin};
use crate::{Scalar, Var};

fn forward<T: Scalar>(x: &[T], y: &mut [T]) {
    kernel::map(y, x, |x| x.ln());
}

fn backward<T: Scalar>(x: &[T], grad_y: &[T], grad_x: &mut [T]) {
    kernel::zip(grad_x, x, grad_y, |x, g| g / x);
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Natural logarithm of every entry.
    ///
    /// **Domain**: `x > 0`; `-∞` at 0, NaN below. **Gradient**: `g / x`, infinite at 0.
    pub fn ln(self) -> Var<'t, T> {
        unary::keep_input("ln", self, forward, backward)
    }
}

#[derive(Clone, Copy, Debug)]
struct Ln;

impl Twin for Ln {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].ln()
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        x[0].map(N::ln)
    }
}

pub(crate) fn proof() -> Proof {
    Proof::unary("ln", Ln, [0.2, 3.0], &[])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random, slopes, values};

    #[test]
    fn values_and_slopes_are_known() {
        let e = std::f64::consts::E;
        close(&values(&[1.0, e, 0.5], |x| x.ln()), &[0.0, 1.0, -std::f64::consts::LN_2]);
        close(&slopes(&[1.0, e, 0.5], |x| x.ln()), &[1.0, 1.0 / e, 2.0]);
    }

    #[test]
    fn boundary_and_outside_of_the_domain_are_visible() {
        close(&values(&[0.0], |x| x.ln()), &[f64::NEG_INFINITY]);
        close(&slopes(&[0.0], |x| x.ln()), &[f64::INFINITY]);
        assert!(values(&[-1.0], |x| x.ln())[0].is_nan());
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), seed in any::<u64>()) {
            let x = random(seed, shape, 0.2, 4.0);
            testing::check(&[x], |v| v[0].ln());
        }
    }
}
