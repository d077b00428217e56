//! `y = k x` with a constant `k`. Vector-Jacobian product: `k g`. Linear. Keeps: nothing.

use super::{kernel, unary};
use crate::proof::{Number, Plain, Proof, Twin};
use crate::{Scalar, Var};

fn forward<T: Scalar>(x: &[T], factor: T, y: &mut [T]) {
    kernel::map(y, x, |x| factor * x);
}

fn backward<T: Scalar>(grad_y: &[T], factor: T, grad_x: &mut [T]) {
    kernel::map(grad_x, grad_y, |g| factor * g);
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Every entry times the constant `factor` (rounded to `T` first).
    ///
    /// **Gradient**: `factor g`.
    pub fn scale(self, factor: f64) -> Var<'t, T> {
        let factor = T::from_f64(factor);
        unary::keep_nothing("scale", self, |x, y| forward(x, factor, y), move |g, out| backward(g, factor, out))
    }
}

#[derive(Clone, Copy, Debug)]
struct Scale(f64);

impl Twin for Scale {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].scale(self.0)
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        x[0].map(|x| N::constant(self.0) * x)
    }
}

pub(crate) fn proof() -> Proof {
    Proof::unary("scale", Scale(-1.75), [-2.0, 2.0], &[]).and(Proof::unary("scale", Scale(0.25), [-2.0, 2.0], &[]))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random, slopes, values};

    #[test]
    fn values_and_slopes_are_known() {
        close(&values(&[1.0, -4.0], |x| x.scale(-0.5)), &[-0.5, 2.0]);
        close(&slopes(&[1.0, -4.0], |x| x.scale(-0.5)), &[-0.5, -0.5]);
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), seed in any::<u64>(), k in 0.5..3.0) {
            testing::check(&[random(seed, shape, -2.0, 2.0)], |v| v[0].scale(k));
        }

        #[test]
        fn adjoint_law_holds(shape in testing::shapes(), seed in any::<u64>(), k in -3.0..3.0) {
            testing::check_adjoint(shape, seed, |x| x.scale(k));
        }
    }
}
