//! `y = 1 / x`. Vector-Jacobian product: `-g y²`. Keeps: the output.
//!
//! Domain: `x ≠ 0`; zero gives an infinite value and derivative. Where zero can occur, use `div_guarded` or `select`
//! a harmless constant first.

use super::{kernel, unary};
use crate::proof::{Number, Plain, Proof, Twin};
use crate::{Scalar, Var};

fn forward<T: Scalar>(x: &[T], y: &mut [T]) {
    kernel::map(y, x, |x| T::ONE / x);
}

fn backward<T: Scalar>(y: &[T], grad_y: &[T], grad_x: &mut [T]) {
    kernel::zip(grad_x, y, grad_y, |y, g| -(g * y * y));
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Reciprocal of every entry.
    ///
    /// **Domain**: `x ≠ 0`, infinite at 0. **Gradient**: `-g / x²`.
    pub fn recip(self) -> Var<'t, T> {
        unary::keep_output("recip", self, forward, backward)
    }
}

#[derive(Clone, Copy, Debug)]
struct Recip;

impl Twin for Recip {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].recip()
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        x[0].map(|x| N::one() / x)
    }
}

pub(crate) fn proof() -> Proof {
    Proof::unary("recip", Recip, [-2.0, 2.0], &[0.0])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random_away, slopes, values};

    #[test]
    fn values_and_slopes_are_known() {
        let x = [2.0, -0.5, 1.0];
        close(&values(&x, |x| x.recip()), &[0.5, -2.0, 1.0]);
        close(&slopes(&x, |x| x.recip()), &[-0.25, -4.0, -1.0]);
    }

    #[test]
    fn division_by_zero_is_visible() {
        close(&values(&[0.0], |x| x.recip()), &[f64::INFINITY]);
        close(&slopes(&[0.0], |x| x.recip()), &[f64::NEG_INFINITY]);
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), seed in any::<u64>()) {
            let x = random_away(seed, shape, 0.3, 3.0, &[]);
            testing::check(&[x], |v| v[0].recip());
        }
    }
}
