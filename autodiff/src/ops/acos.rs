//! `y = arccos x`, radians in [0, π]. Vector-Jacobian product: `-g / √((1 - x)(1 + x))`. Keeps: the input.
//!
//! Domain: `-1 <= x <= 1`; outside, which rounding of a cosine reaches easily, the value is NaN and is not hidden:
//! clamp first. At `x = ±1` the derivative is infinite (NaN for `g = 0`), and in f32 angles below about 3e-4 rad are
//! not resolved: for the angle between two vectors prefer `atan2` of cross and dot product, whose slope is bounded.

use super::{kernel, unary};
use crate::proof::{Number, Plain, Proof, Twin};
use crate::{Scalar, Var};

fn forward<T: Scalar>(x: &[T], y: &mut [T]) {
    kernel::map(y, x, |x| x.acos());
}

fn backward<T: Scalar>(x: &[T], grad_y: &[T], grad_x: &mut [T]) {
    kernel::zip(grad_x, x, grad_y, |x, g| -(g / ((T::ONE - x) * (T::ONE + x)).sqrt()));
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Arc cosine of every entry, in radians.
    ///
    /// **Domain**: `[-1, 1]`, NaN outside. **Gradient**: `-g / √(1 - x²)`, infinite at ±1 (NaN there when `g` is 0);
    /// prefer `atan2` for angles between vectors.
    pub fn acos(self) -> Var<'t, T> {
        unary::keep_input("acos", self, forward, backward)
    }
}

#[derive(Clone, Copy, Debug)]
struct Acos;

impl Twin for Acos {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].acos()
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        x[0].map(N::acos)
    }
}

pub(crate) fn proof() -> Proof {
    Proof::unary("acos", Acos, [-0.95, 0.95], &[])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random, slopes, values};

    #[test]
    fn values_and_slopes_are_known() {
        let pi = std::f64::consts::PI;
        close(&values(&[1.0, 0.5, 0.0, -1.0], |x| x.acos()), &[0.0, pi / 3.0, pi / 2.0, pi]);
        close(&slopes(&[0.6, 0.0, -0.8], |x| x.acos()), &[-1.25, -1.0, -1.0 / 0.6]);
    }

    #[test]
    fn slope_at_the_ends_is_infinite() {
        close(&slopes(&[1.0, -1.0], |x| x.acos()), &[f64::NEG_INFINITY; 2]);
    }

    #[test]
    fn outside_of_the_domain_gives_nan_and_a_clamp_repairs_it() {
        let cosine = [1.0 + 1e-15];
        assert!(values(&cosine, |x| x.acos())[0].is_nan());
        close(&values(&cosine, |x| x.clamp(-1.0, 1.0).acos()), &[0.0]);
        close(&slopes(&[1.0 + 1e-15], |x| x.clamp(-0.96, 0.96).acos()), &[0.0]);
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), seed in any::<u64>()) {
            let x = random(seed, shape, -0.9, 0.9);
            testing::check(&[x], |v| v[0].acos());
        }
    }
}
