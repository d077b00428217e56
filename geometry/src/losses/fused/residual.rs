//! Residuals in pixels: a rounded tip, and what they have beyond the flow's own error.

use dimode_autodiff::Scalar;
use dimode_autodiff::simd::{Simd, Truths, Wide};

use super::rows::{Rows, Sample, add, splat};

/// How residuals become losses.
pub(super) struct Beyond<S: Simd, T: Scalar> {
    tip: Wide<S, T>,
    noisy: bool,
    /// Excess at which a residual begins to count: 0 with noise, else below all.
    floor: Wide<S, T>,
}

/// A residual's part of a loss.
pub(super) struct Excess<S: Simd, T: Scalar> {
    /// What it has beyond the noise.
    pub value: Wide<S, T>,
    /// Where it has something.
    pub counts: Truths<S, T>,
    /// Length before the tip comes off, 1 where that is 0.
    pub length: Wide<S, T>,
}

impl<S: Simd, T: Scalar> Beyond<S, T> {
    #[inline(always)]
    pub(super) fn new(simd: S, sample: &Sample<T>, smooth: T) -> Self {
        let noisy = sample.noise.is_some();
        Self { tip: Wide::splat(simd, smooth), noisy, floor: splat(simd, if noisy { 0.0 } else { -1.0 }) }
    }

    /// `max(sqrt(square + tip^2) - tip - noise, 0)`.
    #[inline(always)]
    pub(super) fn of(&self, simd: S, square: Wide<S, T>, rows: &Rows<'_, T>, at: usize) -> Excess<S, T> {
        let zero = splat(simd, 0.0);
        let length = self.tip.mul_add(self.tip, square).sqrt();
        let value = length - self.tip;
        let value = if self.noisy { value - Wide::load(simd, &rows.noise[at..]) } else { value };
        let counts = self.floor.less(value);
        Excess { value: counts.choose(value, zero), counts, length: zero.less(length).choose(length, splat(simd, 1.0)) }
    }

    /// Takes the gradient of what is beyond the noise from that of the noise.
    #[inline(always)]
    pub(super) fn send(&self, simd: S, rows: &mut Rows<'_, T>, at: usize, g: Wide<S, T>) {
        if self.noisy {
            add(simd, rows.to_noise, at, -g);
        }
    }
}
