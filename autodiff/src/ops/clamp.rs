//! `y = min(max(x, lo), hi)`. Vector-Jacobian product: `g` where `lo <= x <= hi`, 0 outside; at the kinks `x = lo` and
//! `x = hi` the gradient passes. Keeps: the input. NaN stays NaN.

use super::{kernel, unary};
use crate::proof::{Number, Plain, Proof, Twin};
use crate::{Scalar, Var};

fn forward<T: Scalar>(x: &[T], lo: T, hi: T, y: &mut [T]) {
    kernel::map(y, x, |x| {
        if x < lo {
            lo
        } else if x > hi {
            hi
        } else {
            x
        }
    });
}

fn backward<T: Scalar>(x: &[T], lo: T, hi: T, grad_y: &[T], grad_x: &mut [T]) {
    kernel::zip(grad_x, x, grad_y, |x, g| if x < lo || x > hi { T::ZERO } else { g });
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Every entry moved into `[lo, hi]`; a bound may be infinite.
    ///
    /// **Gradient**: `g` inside and on the bounds, 0 outside.
    ///
    /// **Panics** unless `lo <= hi`.
    #[track_caller]
    pub fn clamp(self, lo: f64, hi: f64) -> Var<'t, T> {
        assert!(lo <= hi, "clamp: bounds {lo} and {hi} for shape {}; the rule: lo <= hi, neither NaN", self.shape());
        let (lo, hi) = (T::from_f64(lo), T::from_f64(hi));
        unary::keep_input("clamp", self, |x, y| forward(x, lo, hi, y), move |x, g, out| backward(x, lo, hi, g, out))
    }
}

#[derive(Clone, Copy, Debug)]
struct Clamp(f64, f64);

impl Twin for Clamp {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].clamp(self.0, self.1)
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        x[0].map(|x| x.max(N::constant(self.0)).min(N::constant(self.1)))
    }
}

pub(crate) fn proof() -> Proof {
    Proof::unary("clamp", Clamp(-0.5, 1.0), [-2.0, 2.0], &[-0.5, 1.0]).and(Proof::unary(
        "clamp",
        Clamp(f64::NEG_INFINITY, 0.25),
        [-2.0, 2.0],
        &[0.25],
    ))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random_away, slopes, values};

    #[test]
    fn values_and_slopes_are_known_also_at_the_bounds() {
        let x = [-2.0, -1.0, 0.25, 3.0, 3.5];
        close(&values(&x, |x| x.clamp(-1.0, 3.0)), &[-1.0, -1.0, 0.25, 3.0, 3.0]);
        close(&slopes(&x, |x| x.clamp(-1.0, 3.0)), &[0.0, 1.0, 1.0, 1.0, 0.0]);
    }

    #[test]
    fn infinite_bound_is_no_bound() {
        close(&values(&[-2.0, 1e300], |x| x.clamp(0.0, f64::INFINITY)), &[0.0, 1e300]);
    }

    #[test]
    fn nan_is_not_hidden() {
        assert!(values(&[f64::NAN], |x| x.clamp(0.0, 1.0))[0].is_nan());
    }

    #[test]
    #[should_panic(expected = "clamp: bounds 1 and 0 for shape [1, 1, 1, 1]; the rule: lo <= hi")]
    fn crossed_bounds_are_refused() {
        values(&[0.0], |x| x.clamp(1.0, 0.0));
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), seed in any::<u64>()) {
            let x = random_away(seed, shape, -1.0, 1.0, &[-0.8, 0.8]);
            testing::check(&[x], |v| v[0].clamp(-0.8, 0.8));
        }
    }
}
