//! Forward-mode numbers: a value and its derivative along one direction.

use std::fmt::Debug;
use std::ops::{Add, Div, Mul, Neg, Sub};

/// A value with its derivative along one direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dual {
    /// The value.
    pub value: f64,
    /// Its derivative.
    pub slope: f64,
}

/// What a plain reference computes with: `f64` for values, [`Dual`] for derivatives along a direction.
///
/// Kinks: `abs` has slope 0 at 0; `min` and `max` of equal values follow `self`; `floor` has slope 0 everywhere.
pub trait Number:
    Copy + Debug + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self> + Neg<Output = Self>
{
    /// A number that does not move.
    fn constant(x: f64) -> Self;

    /// The value, without derivative.
    fn value(self) -> f64;

    /// The result of a function with this value and this derivative at `self`: the chain rule.
    fn chain(self, value: f64, slope: f64) -> Self;

    /// 0.
    fn zero() -> Self {
        Self::constant(0.0)
    }

    /// 1.
    fn one() -> Self {
        Self::constant(1.0)
    }

    /// Square root.
    fn sqrt(self) -> Self {
        let root = self.value().sqrt();
        self.chain(root, 0.5 / root)
    }

    /// Exponential.
    fn exp(self) -> Self {
        let y = self.value().exp();
        self.chain(y, y)
    }

    /// Natural logarithm.
    fn ln(self) -> Self {
        self.chain(self.value().ln(), 1.0 / self.value())
    }

    /// `ln(1 + self)`.
    fn ln_1p(self) -> Self {
        self.chain(self.value().ln_1p(), 1.0 / (1.0 + self.value()))
    }

    /// Hyperbolic tangent.
    fn tanh(self) -> Self {
        let y = self.value().tanh();
        self.chain(y, 1.0 / self.value().cosh().powi(2))
    }

    /// Sine, radians.
    fn sin(self) -> Self {
        self.chain(self.value().sin(), self.value().cos())
    }

    /// Cosine, radians.
    fn cos(self) -> Self {
        self.chain(self.value().cos(), -self.value().sin())
    }

    /// Arc cosine, radians.
    fn acos(self) -> Self {
        let x = self.value();
        self.chain(x.acos(), -1.0 / (1.0 - x * x).sqrt())
    }

    /// Angle of the vector `(x, self)`, radians.
    fn atan2(self, x: Self) -> Self {
        let (y, squares) = (self, (self * self + x * x).value());
        let moved = y.chain(y.value().atan2(x.value()), x.value() / squares);
        moved + x.chain(0.0, -y.value() / squares)
    }

    /// Error function, by a series of positive terms.
    fn erf(self) -> Self {
        let x = self.value();
        let (mut term, mut sum, mut k) = (x, x, 1.0);
        while term.abs() > 1e-18 * sum.abs() {
            term *= 2.0 * x * x / (2.0 * k + 1.0);
            sum += term;
            k += 1.0;
        }
        let density = std::f64::consts::FRAC_2_SQRT_PI * (-x * x).exp();
        self.chain(density * sum, density)
    }

    /// Power with a constant exponent.
    fn powf(self, exponent: f64) -> Self {
        let x = self.value();
        self.chain(x.powf(exponent), exponent * x.powf(exponent - 1.0))
    }

    /// Absolute value.
    fn abs(self) -> Self {
        let x = self.value();
        self.chain(x.abs(), if x == 0.0 { 0.0 } else { x.signum() })
    }

    /// Smaller of two.
    fn min(self, other: Self) -> Self {
        if other.value() < self.value() { other } else { self }
    }

    /// Larger of two.
    fn max(self, other: Self) -> Self {
        if other.value() > self.value() { other } else { self }
    }

    /// Largest integer not above.
    fn floor(self) -> Self {
        Self::constant(self.value().floor())
    }
}

impl Number for f64 {
    fn constant(x: f64) -> Self {
        x
    }

    fn value(self) -> f64 {
        self
    }

    fn chain(self, value: f64, _slope: f64) -> Self {
        value
    }
}

impl Number for Dual {
    fn constant(x: f64) -> Self {
        Dual { value: x, slope: 0.0 }
    }

    fn value(self) -> f64 {
        self.value
    }

    fn chain(self, value: f64, slope: f64) -> Self {
        // A number that does not move stays so where the derivative is infinite.
        Dual { value, slope: if self.slope == 0.0 { 0.0 } else { slope * self.slope } }
    }
}

impl Add for Dual {
    type Output = Dual;

    fn add(self, other: Dual) -> Dual {
        Dual { value: self.value + other.value, slope: self.slope + other.slope }
    }
}

impl Sub for Dual {
    type Output = Dual;

    fn sub(self, other: Dual) -> Dual {
        Dual { value: self.value - other.value, slope: self.slope - other.slope }
    }
}

impl Mul for Dual {
    type Output = Dual;

    fn mul(self, other: Dual) -> Dual {
        Dual { value: self.value * other.value, slope: self.slope * other.value + self.value * other.slope }
    }
}

impl Div for Dual {
    type Output = Dual;

    fn div(self, other: Dual) -> Dual {
        let value = self.value / other.value;
        Dual { value, slope: (self.slope - value * other.slope) / other.value }
    }
}

impl Neg for Dual {
    type Output = Dual;

    fn neg(self) -> Dual {
        Dual { value: -self.value, slope: -self.slope }
    }
}

/// The sum of numbers, in order.
pub fn total<N: Number>(terms: impl IntoIterator<Item = N>) -> N {
    terms.into_iter().fold(N::zero(), |sum, term| sum + term)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slopes_match_worked_numbers() {
        let x = Dual { value: 0.25, slope: 2.0 };
        let c = Dual::constant(3.0);
        let near = |a: Dual, value: f64, slope: f64| {
            assert!((a.value - value).abs() < 1e-15 && (a.slope - slope).abs() < 1e-14, "{a:?} against {value}, {slope}");
        };
        near(x * x + c, 3.0625, 1.0);
        near(c / x, 12.0, -96.0);
        near(x.sqrt(), 0.5, 2.0);
        near(x.powf(2.0), 0.0625, 1.0);
        near((-x).abs(), 0.25, 2.0);
        near(x.ln().exp(), 0.25, 2.0);
        near(x.ln_1p(), 1.25_f64.ln(), 1.6);
        near(x.max(c) - x.min(c), 2.75, -2.0);
        near(x.floor(), 0.0, 0.0);
        near(x.sin() * x.sin() + x.cos() * x.cos(), 1.0, 0.0);
        near(x.cos().acos(), 0.25, 2.0);
        near(x.sin().atan2(x.cos()), 0.25, 2.0);
        near(x.tanh(), 0.25_f64.tanh(), 2.0 * (1.0 - 0.25_f64.tanh().powi(2)));
        // erf(0.25) from tables.
        near(x.erf(), 0.276_326_390_168_236_9, 2.0 * 1.060_014_129_376_114_3);
    }

    #[test]
    fn a_number_that_does_not_move_stays_at_an_infinite_slope() {
        assert_eq!(Dual::constant(0.0).sqrt(), Dual::constant(0.0));
    }
}
