//! The number type of a computation: `f32` for training, `f64` for proofs.

use std::fmt::{Debug, Display};
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};

use crate::gemm::GemmScalar;
use crate::ops::conv::ConvScalar;
use crate::simd::SimdScalar;

/// A floating-point element type, implemented by `f32` and `f64`.
pub trait Scalar:
    Copy
    + Default
    + PartialEq
    + PartialOrd
    + Debug
    + Display
    + Send
    + Sync
    + 'static
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
    + MulAssign
    + DivAssign
    + GemmScalar
    + SimdScalar
    + ConvScalar
{
    /// 0.
    const ZERO: Self;
    /// 1.
    const ONE: Self;
    /// Negative infinity.
    const NEG_INFINITY: Self;
    /// Spacing of numbers near 1.
    const EPSILON: Self;
    /// Name in files: `f32` or `f64`.
    const NAME: &'static str;

    /// Nearest value.
    fn from_f64(x: f64) -> Self;
    /// Exact value as `f64`.
    fn to_f64(self) -> f64;
    /// Nearest value.
    fn from_usize(x: usize) -> Self {
        Self::from_f64(x as f64)
    }
    /// The whole number `n` of `n + 1 / EPSILON`, which stands in the low bits; `n` must be below `1 / EPSILON`.
    ///
    /// The cheapest way from a computed index to a place in memory: vector code adds, and only this works number by number.
    fn low_bits(self) -> usize;
    /// Square root.
    fn sqrt(self) -> Self;
    /// Exponential.
    fn exp(self) -> Self;
    /// Natural logarithm.
    fn ln(self) -> Self;
    /// `ln(1 + self)`, exact to rounding also near 0.
    fn ln_1p(self) -> Self;
    /// Absolute value.
    fn abs(self) -> Self;
    /// Smaller of two; the other one where one is NaN.
    fn min(self, other: Self) -> Self;
    /// Larger of two; the other one where one is NaN.
    fn max(self, other: Self) -> Self;
    /// Largest integer not above.
    fn floor(self) -> Self;
    /// Hyperbolic tangent.
    fn tanh(self) -> Self;
    /// Complementary error function, `1 - erf`: twice the mass of a normal distribution of variance 1/2 above this.
    fn erfc(self) -> Self;
    /// Sine, radians.
    fn sin(self) -> Self;
    /// Cosine, radians.
    fn cos(self) -> Self;
    /// Arc cosine, radians.
    fn acos(self) -> Self;
    /// Angle of the vector `(x, self)`, radians in `(-pi, pi]`.
    fn atan2(self, x: Self) -> Self;
    /// `self * a + b`, rounded once.
    fn mul_add(self, a: Self, b: Self) -> Self;
    /// Integer power.
    fn powi(self, n: i32) -> Self;
    /// Power with any exponent; NaN for a negative base and a fractional exponent.
    fn powf(self, exponent: Self) -> Self;
    /// Neither infinite nor NaN.
    fn is_finite(self) -> bool;
    /// Not a number.
    fn is_nan(self) -> bool;
}

macro_rules! scalar {
    ($t:ident, $exp:path, $tanh:path, $erfc:path) => {
        impl Scalar for $t {
            const ZERO: Self = 0.0;
            const ONE: Self = 1.0;
            const NEG_INFINITY: Self = $t::NEG_INFINITY;
            const EPSILON: Self = $t::EPSILON;
            const NAME: &'static str = stringify!($t);
            #[inline(always)]
            fn from_f64(x: f64) -> Self {
                x as $t
            }
            #[inline(always)]
            fn to_f64(self) -> f64 {
                self as f64
            }
            #[inline(always)]
            fn low_bits(self) -> usize {
                (self.to_bits() & ((1 << ($t::MANTISSA_DIGITS - 1)) - 1)) as usize
            }
            #[inline(always)]
            fn exp(self) -> Self {
                $exp(self)
            }
            #[inline(always)]
            fn tanh(self) -> Self {
                $tanh(self)
            }
            #[inline(always)]
            fn erfc(self) -> Self {
                $erfc(self)
            }
            scalar!(@unary $t: sqrt ln ln_1p abs floor sin cos acos);
            scalar!(@binary $t: min max atan2 powf);
            #[inline(always)]
            fn mul_add(self, a: Self, b: Self) -> Self {
                $t::mul_add(self, a, b)
            }
            #[inline(always)]
            fn powi(self, n: i32) -> Self {
                $t::powi(self, n)
            }
            #[inline(always)]
            fn is_finite(self) -> bool {
                $t::is_finite(self)
            }
            #[inline(always)]
            fn is_nan(self) -> bool {
                $t::is_nan(self)
            }
        }
    };
    (@unary $t:ident: $($f:ident)*) => {$(
        #[inline(always)]
        fn $f(self) -> Self {
            $t::$f(self)
        }
    )*};
    (@binary $t:ident: $($f:ident)*) => {$(
        #[inline(always)]
        fn $f(self, other: Self) -> Self {
            $t::$f(self, other)
        }
    )*};
}

scalar!(f32, crate::fast::exp, crate::fast::tanh, crate::erfc::single);
scalar!(f64, f64::exp, f64::tanh, crate::erfc::double);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_numbers_stand_in_the_low_bits() {
        for n in [0, 1, 2, 7, 640 * 192, (1 << 23) - 1] {
            assert_eq!((1.0 / f32::EPSILON + n as f32).low_bits(), n);
            assert_eq!((1.0 / f64::EPSILON + n as f64).low_bits(), n);
        }
    }
}
