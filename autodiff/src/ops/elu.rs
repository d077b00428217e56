//! `y = x` for `x > 0`, else `eˣ - 1` (scale α = 1). Vector-Jacobian product: `g` where `y > 0`, else `g (y + 1)`.
//! The slope is continuous: 1 at `x = 0`. Keeps: the output.

use super::{kernel, unary};
use crate::activation::{self, Activate};
use crate::proof::{Number, Plain, Proof, Twin};
use crate::{Scalar, Var};

fn forward<T: Scalar>(x: &[T], y: &mut [T]) {
    kernel::map(y, x, |x| activation::Elu.of(x));
}

fn backward<T: Scalar>(y: &[T], grad_y: &[T], grad_x: &mut [T]) {
    kernel::zip(grad_x, y, grad_y, |y, g| activation::Elu.back(y, g));
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Exponential linear unit with α = 1.
    ///
    /// **Gradient**: `g` where `x > 0`, else `g eˣ`; 1 at `x = 0`.
    pub fn elu(self) -> Var<'t, T> {
        unary::keep_output("elu", self, forward, backward)
    }
}

#[derive(Clone, Copy, Debug)]
struct Elu;

impl Twin for Elu {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].elu()
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        x[0].map(|x| if x.value() > 0.0 { x } else { x.exp() - N::one() })
    }
}

pub(crate) fn proof() -> Proof {
    Proof::unary("elu", Elu, [-2.0, 2.0], &[0.0])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random_away, slopes, values};

    #[test]
    fn values_and_slopes_are_known() {
        let x = [-2.0_f64.ln(), 0.0, 2.0, -1e4];
        close(&values(&x, |x| x.elu()), &[-0.5, 0.0, 2.0, -1.0]);
        close(&slopes(&x, |x| x.elu()), &[0.5, 1.0, 1.0, 0.0]);
    }

    #[test]
    fn nan_is_not_hidden() {
        assert!(values(&[f64::NAN], |x| x.elu())[0].is_nan());
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), seed in any::<u64>()) {
            let x = random_away(seed, shape, -2.0, 2.0, &[0.0]);
            testing::check(&[x], |v| v[0].elu());
        }
    }
}
