//! `y = tanh x`, in (-1, 1). Vector-Jacobian product: `g (1 - y²)`. No kinks. Keeps: the output.

use super::{kernel, unary};
use crate::proof::{Number, Plain, Proof, Twin};
use crate::{Scalar, Var};

fn forward<T: Scalar>(x: &[T], y: &mut [T]) {
    kernel::map(y, x, |x| x.tanh());
}

fn backward<T: Scalar>(y: &[T], grad_y: &[T], grad_x: &mut [T]) {
    kernel::zip(grad_x, y, grad_y, |y, g| g * (T::ONE - y * y));
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Hyperbolic tangent of every entry.
    ///
    /// **Gradient**: `g (1 - y²)` with the output `y`.
    pub fn tanh(self) -> Var<'t, T> {
        unary::keep_output("tanh", self, forward, backward)
    }
}

#[derive(Clone, Copy, Debug)]
struct Tanh;

impl Twin for Tanh {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].tanh()
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        x[0].map(N::tanh)
    }
}

pub(crate) fn proof() -> Proof {
    // The slope 1 - y² loses two digits at |x| = 3.
    Proof::unary("tanh", Tanh, [-3.0, 3.0], &[]).single_bound(3e-5)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random, slopes, values};

    #[test]
    fn values_and_slopes_are_known() {
        let x = [0.0, 2.0_f64.ln(), -2.0_f64.ln(), 1e4];
        close(&values(&x, |x| x.tanh()), &[0.0, 0.6, -0.6, 1.0]);
        close(&slopes(&x, |x| x.tanh()), &[1.0, 0.64, 0.64, 0.0]);
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), seed in any::<u64>()) {
            let x = random(seed, shape, -2.0, 2.0);
            testing::check(&[x], |v| v[0].tanh());
        }
    }
}
