//! `y = x + k` with a constant `k`. Vector-Jacobian product: `g`. Affine. Keeps: nothing.

use super::{kernel, unary};
use crate::proof::{Number, Plain, Proof, Twin};
use crate::{GradSink, Scalar, Tensor, Var};

fn forward<T: Scalar>(x: &[T], term: T, y: &mut [T]) {
    kernel::map(y, x, |x| x + term);
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Every entry plus the constant `term` (rounded to `T` first).
    ///
    /// **Gradient**: `g`, shared and not copied.
    pub fn add_scalar(self, term: f64) -> Var<'t, T> {
        let y = unary::output(self, |x, y| forward(x, T::from_f64(term), y));
        self.tape().push("add_scalar", y, &[self], |g: &Tensor<T>, grads: &mut GradSink<'_, T>| {
            if let Some(mut slot) = grads.slot(0) {
                slot.add_tensor(g);
            }
        })
    }
}

#[derive(Clone, Copy, Debug)]
struct AddScalar(f64);

impl Twin for AddScalar {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].add_scalar(self.0)
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        x[0].map(|x| x + N::constant(self.0))
    }
}

pub(crate) fn proof() -> Proof {
    Proof::unary("add_scalar", AddScalar(0.75), [-2.0, 2.0], &[]).and(Proof::unary(
        "add_scalar",
        AddScalar(-2.0),
        [-2.0, 2.0],
        &[],
    ))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random, slopes, values};

    #[test]
    fn values_and_slopes_are_known() {
        close(&values(&[1.0, -4.0], |x| x.add_scalar(2.5)), &[3.5, -1.5]);
        close(&slopes(&[1.0, -4.0], |x| x.add_scalar(2.5)), &[1.0, 1.0]);
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), seed in any::<u64>(), k in -3.0..3.0) {
            testing::check(&[random(seed, shape, -2.0, 2.0)], |v| v[0].add_scalar(k));
        }
    }
}
