//! `y = x Φ(x)` with the distribution function `Φ(x) = erfc(-x / √2) / 2` of the normal distribution: the exact form, no tanh.
//! Vector-Jacobian product: `g (Φ(x) + x φ(x))` with the density `φ(x) = e^(-x²/2) / √(2π)`. No kinks. Keeps: the input.
//!
//! Φ comes from the complementary error function on both sides, so that the lower tail keeps its relative precision. NaN stays
//! NaN; at minus infinity, where the limit is 0, the product `-∞ · 0` is NaN.

use std::f64::consts::{FRAC_1_SQRT_2, FRAC_2_SQRT_PI};

use pulp::{Arch, Simd, WithSimd};

use super::unary;
use crate::proof::{Number, Plain, Proof, Twin};
use crate::{Scalar, Var, par};

/// Φ(x).
#[inline(always)]
fn distribution<T: Scalar>(x: T) -> T {
    T::from_f64(0.5) * (x * T::from_f64(-FRAC_1_SQRT_2)).erfc()
}

/// φ(x).
#[inline(always)]
fn density<T: Scalar>(x: T) -> T {
    T::from_f64(0.5 * FRAC_1_SQRT_2 * FRAC_2_SQRT_PI) * (T::from_f64(-0.5) * x * x).exp()
}

/// The loop over values. A closure of this size is called entry by entry, unless the compiler happens to inline it: 15 times as slow.
struct Values<'a, T> {
    x: &'a [T],
    y: &'a mut [T],
}

impl<T: Scalar> WithSimd for Values<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for (y, &x) in self.y.iter_mut().zip(self.x) {
            *y = x * distribution(x);
        }
    }
}

/// The loop over gradients.
struct Slopes<'a, T> {
    x: &'a [T],
    grad_y: &'a [T],
    grad_x: &'a mut [T],
}

impl<T: Scalar> WithSimd for Slopes<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for ((grad_x, &g), &x) in self.grad_x.iter_mut().zip(self.grad_y).zip(self.x) {
            *grad_x = g * (distribution(x) + x * density(x));
        }
    }
}

fn forward<T: Scalar>(x: &[T], y: &mut [T]) {
    par::for_each_chunk(y, par::CHUNK, |i, y| {
        Arch::new().dispatch(Values { x: &x[i * par::CHUNK..][..y.len()], y });
    });
}

fn backward<T: Scalar>(x: &[T], grad_y: &[T], grad_x: &mut [T]) {
    par::for_each_chunk(grad_x, par::CHUNK, |i, grad_x| {
        let [x, grad_y] = [x, grad_y].map(|all| &all[i * par::CHUNK..][..grad_x.len()]);
        Arch::new().dispatch(Slopes { x, grad_y, grad_x });
    });
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Gaussian error linear unit of every entry: `x Φ(x)`, exact.
    ///
    /// **Shapes**: any to the same.
    ///
    /// **Gradient**: `g (Φ(x) + x φ(x))`; 1/2 at `x = 0`. Equals PyTorch's `gelu(approximate="none")`.
    pub fn gelu(self) -> Var<'t, T> {
        unary::keep_input("gelu", self, forward, backward)
    }
}

#[derive(Clone, Copy, Debug)]
struct Gelu;

impl Twin for Gelu {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].gelu()
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        x[0].map(|x| x * N::constant(0.5) * (N::one() + (x / N::constant(2.0).sqrt()).erf()))
    }
}

pub(crate) fn proof() -> Proof {
    Proof::unary("gelu", Gelu, [-3.0, 3.0], &[])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random, slopes, values};
    use crate::{Shape, Tape, Tensor};

    #[test]
    fn values_and_slopes_are_known() {
        // Φ(1) = 0.841344746068543 and φ(1) = 0.241970724519143.
        let x = [0.0, 1.0, -1.0, -2.0];
        close(&values(&x, |x| x.gelu()), &[0.0, 0.841344746068543, -0.158655253931457, -0.0455002638963584]);
        close(&slopes(&x, |x| x.gelu()), &[0.5, 1.083315470587686, -0.083315470587686, -0.0852318010781969]);
    }

    #[test]
    fn tails_are_flat_and_keep_their_relative_precision() {
        close(&values(&[-60.0, 60.0], |x| x.gelu()), &[0.0, 60.0]);
        close(&slopes(&[-60.0, 60.0, -1e4, 1e4], |x| x.gelu()), &[0.0, 1.0, 0.0, 1.0]);
        // -10 Φ(-10) = -7.619853024160527e-23.
        assert!((values(&[-10.0], |x| x.gelu())[0] / -7.619853024160527e-23 - 1.0).abs() < 1e-13);
    }

    #[test]
    fn nan_is_not_hidden() {
        assert!(values(&[f64::NAN], |x| x.gelu())[0].is_nan());
        assert!(slopes(&[f64::NAN], |x| x.gelu())[0].is_nan());
    }

    #[test]
    fn single_precision_follows_double_precision() {
        let x: Tensor<f32> = random(1, Shape::new(1, 1, 1, 5000), -8.0, 8.0);
        let y = Tape::new().constant(x.clone()).gelu().value();
        let want = values(x.cast::<f64>().data(), |x| x.gelu());
        for ((x, y), want) in x.data().iter().zip(y.data()).zip(want) {
            assert!((f64::from(*y) - want).abs() <= 1e-5 * want.abs(), "{x}: {y} against {want}");
        }
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), seed in any::<u64>()) {
            testing::check(&[random(seed, shape, -3.0, 3.0)], |v| v[0].gelu());
        }
    }
}
