//! What the printed `L_tan` and `L_rad` have in common: `A + C` of one axis, see
//! [`RatioTerm`](crate::losses::RatioTerm).
//!
//! Vector-Jacobian products, with `q = g_A w sign(rho a - z) / z`: of `A = E[|rho a - z| / z]` to `rho` `q a`, to `z` `-q rho a / z`,
//! to `a` `q rho`; of `C = |E[r] - a| / |a|` with `s = sign(E[r] / a - 1)` to every `r` `s w / (a sum w)`, to `a` `-s E[r] / a^2`.

use dimode_autodiff::Scalar;
use dimode_autodiff::simd::{Simd, Truths, Wide};

use super::rows::{Rows, Sums, WEIGHT, splat};

/// Places of the sums of one axis among those of a loss.
#[derive(Clone, Copy)]
pub(super) struct Axis {
    /// The weights of `A`, its errors, the recovered components.
    first: usize,
    /// `a`.
    a: f64,
}

/// Number of sums of one axis.
pub(super) const SUMS: usize = 3;

/// What `A` and `C` send back to every pixel.
#[derive(Clone, Copy, Default)]
pub(super) struct Shares {
    /// Of an error with weight 1.
    pub error: f64,
    /// Of a recovered component with weight 1.
    pub recovered: f64,
    /// To `a` from `C`.
    pub to_a: f64,
}

impl Axis {
    pub(super) fn new(first: usize, a: f64) -> Self {
        Self { first, a }
    }

    /// `E[z / rho]`.
    fn recovered(self, sums: &Sums) -> f64 {
        if sums[WEIGHT] == 0.0 { 0.0 } else { sums[self.first + 2] / sums[WEIGHT] }
    }

    /// `A + C`; without `C` where `a` is exactly 0.
    pub(super) fn value(self, sums: &Sums) -> f64 {
        let [weight, errors] = [sums[self.first], sums[self.first + 1]];
        let pixels = if weight == 0.0 { 0.0 } else { errors / weight };
        let aggregate = if self.a == 0.0 { 0.0 } else { ((self.recovered(sums) - self.a) / self.a).abs() };
        pixels + aggregate
    }

    pub(super) fn shares(self, g: f64, sums: &Sums) -> Shares {
        let error = if sums[self.first] == 0.0 { 0.0 } else { g / sums[self.first] };
        let mut shares = Shares { error, recovered: 0.0, to_a: 0.0 };
        if self.a != 0.0 {
            let recovered = self.recovered(sums);
            let difference = (recovered - self.a) / self.a;
            let g = if difference == 0.0 { 0.0 } else { g * difference.signum() };
            shares.recovered = if sums[WEIGHT] == 0.0 { 0.0 } else { g / (self.a * sums[WEIGHT]) };
            shares.to_a = -g * recovered / (self.a * self.a);
        }
        shares
    }
}

/// Target depths of a register where they are in front of the camera.
pub(super) struct Depth<S: Simd, T: Scalar> {
    pub used: Truths<S, T>,
    /// 1 where not used.
    pub z: Wide<S, T>,
    /// `1 / z`.
    pub inverse: Wide<S, T>,
    /// 0 where not used.
    pub weight: Wide<S, T>,
}

impl<S: Simd, T: Scalar> Depth<S, T> {
    #[inline(always)]
    pub(super) fn of(simd: S, rows: &Rows<'_, T>, at: usize) -> Self {
        let weight = Wide::load(simd, &rows.front_weight[at..]);
        let used = splat(simd, 0.0).less(weight.abs());
        let z = used.choose(Wide::load(simd, &rows.target_depth[at..]), splat(simd, 1.0));
        Self { used, z, inverse: Wide::load(simd, &rows.inverse_depth[at..]), weight }
    }
}

/// Error of the ratio at the pixels of a register.
pub(super) struct PixelError<S: Simd, T: Scalar> {
    /// `|rho a - z| / z`.
    pub error: Wide<S, T>,
    /// `sign(rho a - z) / z`.
    pub slope: Wide<S, T>,
    /// `rho a / z`.
    pub relative: Wide<S, T>,
}

impl<S: Simd, T: Scalar> PixelError<S, T> {
    #[inline(always)]
    pub(super) fn of(rho_a: Wide<S, T>, Depth { z, inverse, .. }: &Depth<S, T>) -> Self {
        let (zero, inverse) = (z.like(T::ZERO), *inverse);
        let difference = rho_a - *z;
        let slope = zero.less(difference).choose(inverse, difference.less(zero).choose(-inverse, zero));
        Self { error: difference.abs() * inverse, slope, relative: rho_a * inverse }
    }
}
