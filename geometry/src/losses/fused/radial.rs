//! `L_rad`, see [`radial`](crate::losses::radial()).
//!
//! With `d = p - p0` and `b = d . f_axi`:
//! - As printed: `A + C` of `rho = -(b + |d|^2) / b`, whose slope by `b` is `|d|^2 / b^2`, with `z / rho = -z b / (b + |d|^2)`,
//!   whose slope is `-z |d|^2 / (b + |d|^2)^2`.
//! - In pixels: mean of `|r|`, `r = b / |d| + |d| a_z / (z + a_z)`.

use dimode_autodiff::Scalar;
use dimode_autodiff::simd::{Simd, Truths, Wide};

use super::planar::add_pixel;
use super::ratio::{Axis, Depth, PixelError, SUMS};
use super::residual::Beyond;
use super::rows::{Rows, Sample, Sums, WEIGHT, add, add_sums, load2, splat};
use crate::losses::{LossOptions, RadialForm};

/// The loss of one sample.
pub(super) enum Radial<T> {
    /// As printed.
    Literal,
    /// As printed where the axis does not count.
    Nothing,
    /// In pixels.
    Pixels {
        /// Smallest distance from the principal point, pixels.
        q_min: T,
        smooth: T,
    },
}

/// Sums before those of the axis.
const OWN: usize = 2;

fn axis<T: Scalar>(sample: &Sample<T>) -> Axis {
    Axis::new(OWN, sample.motion.t[2].to_f64())
}

impl<T: Scalar> Radial<T> {
    /// `None` for the other forms.
    pub(super) fn new(options: &LossOptions) -> Option<Self> {
        match options.radial {
            RadialForm::Literal if options.axes[2] => Some(Self::Literal),
            RadialForm::Literal => Some(Self::Nothing),
            RadialForm::FlowPixels => {
                let q_min = T::from_f64(options.q_min.max(1e-6));
                Some(Self::Pixels { q_min, smooth: T::from_f64(options.smooth_pixels) })
            }
            RadialForm::Robust | RadialForm::InverseRatio => None,
        }
    }

    /// Adds the sums of a row.
    #[inline(always)]
    pub(super) fn sum<S: Simd>(&self, simd: S, sample: &Sample<T>, rows: &Rows<'_, T>, sums: &mut Sums) {
        let a = Wide::splat(simd, sample.motion.t[2]);
        let zero = splat(simd, 0.0);
        let step = Wide::<S, T>::lanes();
        match *self {
            Self::Nothing => {}
            Self::Literal => {
                let mut totals = [zero; OWN + SUMS];
                for at in (0..rows.padded()).step_by(step) {
                    let p = Along::of(simd, rows, at);
                    let w = p.recovers.choose(p.depth.weight, zero);
                    add_pixel(&mut totals, p.recovers, w);
                    totals[4] = totals[4] - w * p.depth.z * p.along / p.whole;
                    let w = p.divides.choose(p.depth.weight, zero);
                    totals[2] = totals[2] + w;
                    totals[3] = w.mul_add(PixelError::of(p.rho * a, &p.depth).error, totals[3]);
                }
                add_sums(sums, totals);
            }
            Self::Pixels { q_min, smooth } => {
                let mut totals = [zero; 3];
                let beyond = Beyond::new(simd, sample, smooth);
                for at in (0..rows.padded()).step_by(step) {
                    let p = Residual::of(simd, sample, rows, q_min, at);
                    let w = p.used.choose(p.weight, zero);
                    add_pixel(&mut totals, p.used, w);
                    totals[2] = w.mul_add(beyond.of(simd, p.residual * p.residual, rows, at).value, totals[2]);
                }
                add_sums(sums, totals);
            }
        }
    }

    /// The loss.
    pub(super) fn value(&self, sample: &Sample<T>, sums: &Sums) -> f64 {
        match self {
            Self::Literal => axis(sample).value(sums),
            Self::Pixels { .. } if sums[WEIGHT] != 0.0 => sums[2] / sums[WEIGHT],
            Self::Nothing | Self::Pixels { .. } => 0.0,
        }
    }

    /// Adds the gradients of a row to its axial flows and target depths, and that of `a_z` to its sum.
    #[inline(always)]
    pub(super) fn spread<S: Simd>(
        &self,
        simd: S,
        sample: &Sample<T>,
        (g, sums): (f64, &Sums),
        rows: &mut Rows<'_, T>,
        to_a: &mut f64,
    ) {
        if g == 0.0 {
            return;
        }
        match *self {
            Self::Literal => spread_ratio(simd, sample, (g, sums), rows, to_a),
            Self::Pixels { q_min, smooth } if sums[WEIGHT] != 0.0 => {
                spread_pixels(simd, sample, [q_min, smooth], g / sums[WEIGHT], rows, to_a);
            }
            Self::Nothing | Self::Pixels { .. } => {}
        }
    }

    /// Gradient of `a` that no pixel takes part in.
    pub(super) fn to_translation(&self, sample: &Sample<T>, g: f64, sums: &Sums) -> [f64; 3] {
        match self {
            Self::Literal if g != 0.0 => [0.0, 0.0, axis(sample).shares(g, sums).to_a],
            _ => [0.0; 3],
        }
    }
}

#[inline(always)]
fn spread_ratio<S: Simd, T: Scalar>(
    simd: S,
    sample: &Sample<T>,
    (g, sums): (f64, &Sums),
    rows: &mut Rows<'_, T>,
    to_a: &mut f64,
) {
    let shares = axis(sample).shares(g, sums);
    let (share, recovered) = (splat(simd, shares.error), splat(simd, shares.recovered));
    let (zero, a) = (splat(simd, 0.0), Wide::splat(simd, sample.motion.t[2]));
    let mut total = zero;
    for at in (0..rows.padded()).step_by(Wide::<S, T>::lanes()) {
        let p = Along::of(simd, rows, at);
        let e = PixelError::of(p.rho * a, &p.depth);
        let q = share * p.divides.choose(p.depth.weight, zero) * e.slope;
        // 1 over the whole, so that no square of a divisor can underflow.
        let inverse = splat(simd, 1.0) / p.whole;
        let r = recovered * p.recovers.choose(p.depth.weight, zero) * inverse;
        total = q.mul_add(p.rho, total);
        add(simd, rows.to_target_depth, at, -(r * p.along) - q * e.relative);
        let to_along = q * a * (p.square * p.inverse) * p.inverse - r * p.depth.z * p.square * inverse;
        add(simd, rows.to_axial[0], at, to_along * p.offset[0]);
        add(simd, rows.to_axial[1], at, to_along * p.offset[1]);
    }
    *to_a += total.sum().to_f64();
}

#[inline(always)]
fn spread_pixels<S: Simd, T: Scalar>(
    simd: S,
    sample: &Sample<T>,
    [q_min, smooth]: [T; 2],
    share: f64,
    rows: &mut Rows<'_, T>,
    to_a: &mut f64,
) {
    let (share, zero) = (splat(simd, share), splat(simd, 0.0));
    let a = Wide::splat(simd, sample.motion.t[2]);
    let beyond = Beyond::new(simd, sample, smooth);
    let mut total = zero;
    for at in (0..rows.padded()).step_by(Wide::<S, T>::lanes()) {
        let p = Residual::of(simd, sample, rows, q_min, at);
        let excess = beyond.of(simd, p.residual * p.residual, rows, at);
        let s = (p.used & excess.counts).choose(share * p.weight, zero);
        beyond.send(simd, rows, at, s);
        let s = s * p.residual / excess.length;
        let along = s / p.radius;
        add(simd, rows.to_axial[0], at, along * p.offset[0]);
        add(simd, rows.to_axial[1], at, along * p.offset[1]);
        let by_square = s * p.radius * p.inverse * p.inverse;
        add(simd, rows.to_target_depth, at, -(by_square * a));
        total = by_square.mul_add(p.z, total);
    }
    *to_a += total.sum().to_f64();
}

/// Radial parts of the axial flows of a register.
struct Along<S: Simd, T: Scalar> {
    depth: Depth<S, T>,
    offset: [Wide<S, T>; 2],
    /// `|d|^2`.
    square: Wide<S, T>,
    /// `b`.
    along: Wide<S, T>,
    /// Where `b` can be divided by, and `1 / b` with 1 elsewhere.
    divides: Truths<S, T>,
    inverse: Wide<S, T>,
    rho: Wide<S, T>,
    /// Where the component can be recovered, and `b + |d|^2` with 1 elsewhere.
    recovers: Truths<S, T>,
    whole: Wide<S, T>,
}

impl<S: Simd, T: Scalar> Along<S, T> {
    #[inline(always)]
    fn of(simd: S, rows: &Rows<'_, T>, at: usize) -> Self {
        let (zero, one) = (splat(simd, 0.0), splat(simd, 1.0));
        let depth = Depth::of(simd, rows, at);
        let [u, v] = load2(simd, &rows.axial, at);
        let (x, y) = (Wide::load(simd, &rows.offset[at..]), Wide::splat(simd, rows.offset_v));
        let (square, along) = (x * x + y * y, x * u + y * v);
        let off = depth.used & zero.less(square);
        let divides = off & zero.less(along.abs());
        let inverse = one / divides.choose(along, one);
        let whole = along + square;
        let recovers = off & zero.less(whole.abs());
        let rho = -(whole * inverse);
        Self { depth, offset: [x, y], square, along, divides, inverse, rho, recovers, whole: recovers.choose(whole, one) }
    }
}

/// Residuals of the pixel form in a register.
struct Residual<S: Simd, T: Scalar> {
    used: Truths<S, T>,
    weight: Wide<S, T>,
    z: Wide<S, T>,
    offset: [Wide<S, T>; 2],
    /// `|d|`, at least `q_min`.
    radius: Wide<S, T>,
    /// `1 / (z + a_z)`.
    inverse: Wide<S, T>,
    residual: Wide<S, T>,
}

impl<S: Simd, T: Scalar> Residual<S, T> {
    #[inline(always)]
    fn of(simd: S, sample: &Sample<T>, rows: &Rows<'_, T>, q_min: T, at: usize) -> Self {
        let depth = Depth::of(simd, rows, at);
        let [u, v] = load2(simd, &rows.axial, at);
        let (x, y) = (Wide::load(simd, &rows.offset[at..]), Wide::splat(simd, rows.offset_v));
        let (a, q_min) = (Wide::splat(simd, sample.motion.t[2]), Wide::splat(simd, q_min));
        let radius = (x * x + y * y).sqrt();
        let z = depth.z + a;
        let used = depth.used & q_min.at_most(radius) & Wide::splat(simd, sample.z_min).less(z);
        let radius = radius.max(q_min);
        let inverse = splat(simd, 1.0) / used.choose(z, splat(simd, 1.0));
        let residual = (x * u + y * v) / radius + radius * a * inverse;
        Self { used, weight: depth.weight, z: depth.z, offset: [x, y], radius, inverse, residual }
    }
}
