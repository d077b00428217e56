//! `y = x²`. Vector-Jacobian product: `2 g x`. No kinks. Keeps: the input.

use super::{kernel, unary};
use crate::proof::{Number, Plain, Proof, Twin};
use crate::{Scalar, Var};

fn forward<T: Scalar>(x: &[T], y: &mut [T]) {
    kernel::map(y, x, |x| x * x);
}

fn backward<T: Scalar>(x: &[T], grad_y: &[T], grad_x: &mut [T]) {
    kernel::zip(grad_x, x, grad_y, |x, g| (x + x) * g);
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Square of every entry.
    ///
    /// **Gradient**: `2 g x`.
    pub fn square(self) -> Var<'t, T> {
        unary::keep_input("square", self, forward, backward)
    }
}

#[derive(Clone, Copy, Debug)]
struct Square;

impl Twin for Square {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].square()
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        x[0].map(|x| x * x)
    }
}

pub(crate) fn proof() -> Proof {
    Proof::unary("square", Square, [-2.0, 2.0], &[])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random, slopes, values};

    #[test]
    fn values_and_slopes_are_known() {
        let x = [-3.0, 0.0, 0.5];
        close(&values(&x, |x| x.square()), &[9.0, 0.0, 0.25]);
        close(&slopes(&x, |x| x.square()), &[-6.0, 0.0, 1.0]);
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), seed in any::<u64>()) {
            let x = random(seed, shape, -2.0, 2.0);
            testing::check(&[x], |v| v[0].square());
        }
    }
}
