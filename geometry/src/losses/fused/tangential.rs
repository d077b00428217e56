//! `L_tan`, see [`tangential`](crate::losses::tangential()).
//!
//! - As printed: `A + C` of `rho = f / f_pla` along u and v, with `z / rho = z f_pla / f`.
//! - In pixels: mean length of `r = f_pla - f o a_tan / z`.

use dimode_autodiff::Scalar;
use dimode_autodiff::simd::{Simd, Wide};

use super::planar::add_pixel;
use super::ratio::{Axis, Depth, PixelError, SUMS, Shares};
use super::residual::Beyond;
use super::rows::{Rows, Sample, Sums, WEIGHT, add, add_sums, load2, splat};
use crate::losses::{LossOptions, TangentialForm};

/// The loss of one sample.
pub(super) enum Tangential<T> {
    /// As printed, over the axes that count.
    Literal { axes: [bool; 2] },
    /// In pixels.
    Pixels { smooth: T },
}

/// Sums before those of the axes.
const OWN: usize = 2;

/// The axis `k` among the sums.
fn axis<T: Scalar>(sample: &Sample<T>, k: usize) -> Axis {
    Axis::new(OWN + SUMS * k, sample.motion.t[k].to_f64())
}

impl<T: Scalar> Tangential<T> {
    /// `None` for the other forms.
    pub(super) fn new(options: &LossOptions) -> Option<Self> {
        match options.tangential {
            TangentialForm::Literal => Some(Self::Literal { axes: [options.axes[0], options.axes[1]] }),
            TangentialForm::FlowPixels => Some(Self::Pixels { smooth: T::from_f64(options.smooth_pixels) }),
            TangentialForm::Robust | TangentialForm::InverseRatio => None,
        }
    }

    /// Adds the sums of a row.
    #[inline(always)]
    pub(super) fn sum<S: Simd>(&self, simd: S, sample: &Sample<T>, rows: &Rows<'_, T>, sums: &mut Sums) {
        let m = &sample.motion;
        let (zero, one) = (splat(simd, 0.0), splat(simd, 1.0));
        let focal = [Wide::splat(simd, m.fu), Wide::splat(simd, m.fv)];
        let a = [Wide::splat(simd, m.t[0]), Wide::splat(simd, m.t[1])];
        let step = Wide::<S, T>::lanes();
        match *self {
            Self::Literal { axes } => {
                let mut totals = [zero; OWN + 2 * SUMS];
                let inverse = [Wide::splat(simd, sample.inverse_focal[0]), Wide::splat(simd, sample.inverse_focal[1])];
                for at in (0..rows.padded()).step_by(step) {
                    let depth = Depth::of(simd, rows, at);
                    add_pixel(&mut totals, depth.used, depth.weight);
                    let flow = load2(simd, &rows.planar, at);
                    for k in 0..2 {
                        let divides = depth.used & zero.less(flow[k].abs());
                        let rho = focal[k] / divides.choose(flow[k], one);
                        let w = divides.choose(depth.weight, zero);
                        let first = OWN + SUMS * k;
                        totals[first] = totals[first] + w;
                        totals[first + 1] = w.mul_add(PixelError::of(rho * a[k], &depth).error, totals[first + 1]);
                        totals[first + 2] = (depth.weight * depth.z).mul_add(flow[k] * inverse[k], totals[first + 2]);
                    }
                }
                for k in (0..2).filter(|&k| !axes[k]) {
                    totals[OWN + SUMS * k..][..SUMS].fill(zero);
                }
                add_sums(sums, totals);
            }
            Self::Pixels { smooth } => {
                let mut totals = [zero; 3];
                let beyond = Beyond::new(simd, sample, smooth);
                for at in (0..rows.padded()).step_by(step) {
                    let depth = Depth::of(simd, rows, at);
                    add_pixel(&mut totals, depth.used, depth.weight);
                    let [u, v] = load2(simd, &rows.planar, at);
                    let inverse = depth.inverse;
                    let (x, y) = (u - focal[0] * a[0] * inverse, v - focal[1] * a[1] * inverse);
                    totals[2] = depth.weight.mul_add(beyond.of(simd, x * x + y * y, rows, at).value, totals[2]);
                }
                add_sums(sums, totals);
            }
        }
    }

    /// The loss.
    pub(super) fn value(&self, sample: &Sample<T>, sums: &Sums) -> f64 {
        match self {
            Self::Literal { axes } => (0..2).filter(|&k| axes[k]).map(|k| axis(sample, k).value(sums)).sum(),
            Self::Pixels { .. } if sums[WEIGHT] == 0.0 => 0.0,
            Self::Pixels { .. } => sums[2] / sums[WEIGHT],
        }
    }

    /// Adds the gradients of a row to its planar flows and target depths, and that of `a` to its sums.
    #[inline(always)]
    pub(super) fn spread<S: Simd>(
        &self,
        simd: S,
        sample: &Sample<T>,
        (g, sums): (f64, &Sums),
        rows: &mut Rows<'_, T>,
        to_a: &mut [f64],
    ) {
        if g == 0.0 {
            return;
        }
        match *self {
            Self::Literal { axes } => {
                let shares = [0, 1].map(|k| if axes[k] { axis(sample, k).shares(g, sums) } else { Shares::default() });
                spread_ratios(simd, sample, shares, rows, to_a);
            }
            Self::Pixels { smooth } if sums[WEIGHT] != 0.0 => {
                spread_pixels(simd, sample, smooth, g / sums[WEIGHT], rows, to_a);
            }
            Self::Pixels { .. } => {}
        }
    }

    /// Gradient of `a` that no pixel takes part in.
    pub(super) fn to_translation(&self, sample: &Sample<T>, g: f64, sums: &Sums) -> [f64; 3] {
        let mut to_a = [0.0; 3];
        if let (Self::Literal { axes }, true) = (self, g != 0.0) {
            for k in (0..2).filter(|&k| axes[k]) {
                to_a[k] = axis(sample, k).shares(g, sums).to_a;
            }
        }
        to_a
    }
}

#[inline(always)]
fn spread_ratios<S: Simd, T: Scalar>(simd: S, sample: &Sample<T>, shares: [Shares; 2], rows: &mut Rows<'_, T>, to_a: &mut [f64]) {
    let error = [splat(simd, shares[0].error), splat(simd, shares[1].error)];
    let (zero, one) = (splat(simd, 0.0), splat(simd, 1.0));
    let m = &sample.motion;
    let focal = [Wide::splat(simd, m.fu), Wide::splat(simd, m.fv)];
    let a = [Wide::splat(simd, m.t[0]), Wide::splat(simd, m.t[1])];
    let [fu, fv] = sample.inverse_focal;
    let recovered =
        [splat(simd, shares[0].recovered) * Wide::splat(simd, fu), splat(simd, shares[1].recovered) * Wide::splat(simd, fv)];
    let mut totals = [zero; 2];
    for at in (0..rows.padded()).step_by(Wide::<S, T>::lanes()) {
        let depth = Depth::of(simd, rows, at);
        let flow = load2(simd, &rows.planar, at);
        let mut to_depth = zero;
        for k in 0..2 {
            let divides = depth.used & zero.less(flow[k].abs());
            let inverse = one / divides.choose(flow[k], one);
            let rho = focal[k] * inverse;
            let e = PixelError::of(rho * a[k], &depth);
            let q = error[k] * divides.choose(depth.weight, zero) * e.slope;
            let r = recovered[k] * depth.weight;
            totals[k] = q.mul_add(rho, totals[k]);
            add(simd, rows.to_planar[k], at, r * depth.z - q * a[k] * rho * inverse);
            to_depth = to_depth + (r * flow[k] - q * e.relative);
        }
        add(simd, rows.to_target_depth, at, to_depth);
    }
    add_sums(to_a, totals);
}

#[inline(always)]
fn spread_pixels<S: Simd, T: Scalar>(
    simd: S,
    sample: &Sample<T>,
    smooth: T,
    share: f64,
    rows: &mut Rows<'_, T>,
    to_a: &mut [f64],
) {
    let m = &sample.motion;
    let (share, zero) = (splat(simd, share), splat(simd, 0.0));
    let focal = [Wide::splat(simd, m.fu), Wide::splat(simd, m.fv)];
    let a = [Wide::splat(simd, m.t[0]), Wide::splat(simd, m.t[1])];
    let beyond = Beyond::new(simd, sample, smooth);
    let mut totals = [zero; 2];
    for at in (0..rows.padded()).step_by(Wide::<S, T>::lanes()) {
        let depth = Depth::of(simd, rows, at);
        let [u, v] = load2(simd, &rows.planar, at);
        let inverse = depth.inverse;
        let [fx, fy] = [focal[0] * inverse, focal[1] * inverse];
        let (px, py) = (fx * a[0], fy * a[1]);
        let (x, y) = (u - px, v - py);
        let excess = beyond.of(simd, x * x + y * y, rows, at);
        let s = (depth.used & excess.counts).choose(share * depth.weight, zero);
        beyond.send(simd, rows, at, s);
        let s = s / excess.length;
        let (x, y) = (s * x, s * y);
        add(simd, rows.to_planar[0], at, x);
        add(simd, rows.to_planar[1], at, y);
        add(simd, rows.to_target_depth, at, x.mul_add(px, y * py) * inverse);
        totals = [totals[0] - x * fx, totals[1] - y * fy];
    }
    add_sums(to_a, totals);
}
