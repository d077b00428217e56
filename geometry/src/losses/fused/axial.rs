//! `L_axi`, see [`axial`](crate::losses::axial()).
//!
//! With `d = p - p0`: mean angle `arccos(f . d / (|f| |d|))`, whose slope by the flow is `sign(d x f) (-f_v, f_u) / |f|^2`, 0 where
//! the cosine is 1 to rounding; or mean distance `d x f / |d|` from the radial line.

use dimode_autodiff::Scalar;
use dimode_autodiff::simd::{Simd, Truths, Wide};

use super::planar::add_pixel;
use super::residual::Beyond;
use super::rows::{Rows, Sample, Sums, WEIGHT, add, add_sums, load2, splat};
use crate::losses::{AxialForm, LossOptions};

/// The loss of one sample.
pub(super) enum Axial<T> {
    /// As printed.
    Literal,
    /// In pixels.
    Pixels {
        /// Smallest distance from the principal point, pixels.
        q_min: T,
        smooth: T,
    },
}

impl<T: Scalar> Axial<T> {
    /// `None` for the other forms.
    pub(super) fn new(options: &LossOptions) -> Option<Self> {
        match options.axial {
            AxialForm::Literal => Some(Self::Literal),
            AxialForm::PerpendicularPixels => {
                let q_min = T::from_f64(options.q_min.max(1e-6));
                Some(Self::Pixels { q_min, smooth: T::from_f64(options.smooth_pixels) })
            }
            AxialForm::Signed | AxialForm::Folded | AxialForm::PoseSign => None,
        }
    }

    /// Adds the sums of a row.
    #[inline(always)]
    pub(super) fn sum<S: Simd>(&self, simd: S, sample: &Sample<T>, rows: &Rows<'_, T>, sums: &mut Sums) {
        let zero = splat(simd, 0.0);
        let mut totals = [zero; 3];
        let step = Wide::<S, T>::lanes();
        match *self {
            Self::Literal => {
                for at in (0..rows.padded()).step_by(step) {
                    let p = Angle::of(simd, rows, at);
                    let w = p.used.choose(Wide::load(simd, &rows.weight[at..]), zero);
                    add_pixel(&mut totals, p.used, w);
                    totals[2] = w.mul_add(p.cosine().arccos(), totals[2]);
                }
            }
            Self::Pixels { q_min, smooth } => {
                let beyond = Beyond::new(simd, sample, smooth);
                for at in (0..rows.padded()).step_by(step) {
                    let p = Distance::of(simd, rows, q_min, at);
                    let w = p.used.choose(Wide::load(simd, &rows.weight[at..]), zero);
                    add_pixel(&mut totals, p.used, w);
                    totals[2] = w.mul_add(beyond.of(simd, p.distance * p.distance, rows, at).value, totals[2]);
                }
            }
        }
        add_sums(sums, totals);
    }

    /// The loss.
    pub(super) fn value(&self, sums: &Sums) -> f64 {
        if sums[WEIGHT] == 0.0 { 0.0 } else { sums[2] / sums[WEIGHT] }
    }

    /// Adds the gradients of a row to its axial flows.
    #[inline(always)]
    pub(super) fn spread<S: Simd>(&self, simd: S, sample: &Sample<T>, (g, sums): (f64, &Sums), rows: &mut Rows<'_, T>) {
        if g == 0.0 || sums[WEIGHT] == 0.0 {
            return;
        }
        let zero = splat(simd, 0.0);
        let share = splat(simd, g / sums[WEIGHT]);
        let step = Wide::<S, T>::lanes();
        match *self {
            Self::Literal => {
                for at in (0..rows.padded()).step_by(step) {
                    let p = Angle::of(simd, rows, at);
                    // The squares stand for a cosine below 1, which would take two roots and a division.
                    let slopes = p.used & zero.less(p.across.abs()) & (p.along * p.along).less(p.square * p.radius_square);
                    let s = slopes.choose(share * Wide::load(simd, &rows.weight[at..]) / p.square, zero);
                    let s = p.across.less(zero).choose(-s, s);
                    let [u, v] = p.flow;
                    add(simd, rows.to_axial[0], at, -(s * v));
                    add(simd, rows.to_axial[1], at, s * u);
                }
            }
            Self::Pixels { q_min, smooth } => {
                let beyond = Beyond::new(simd, sample, smooth);
                for at in (0..rows.padded()).step_by(step) {
                    let p = Distance::of(simd, rows, q_min, at);
                    let excess = beyond.of(simd, p.distance * p.distance, rows, at);
                    let s = (p.used & excess.counts).choose(share * Wide::load(simd, &rows.weight[at..]), zero);
                    beyond.send(simd, rows, at, s);
                    let s = s * p.distance / (excess.length * p.radius);
                    add(simd, rows.to_axial[0], at, -(s * p.offset[1]));
                    add(simd, rows.to_axial[1], at, s * p.offset[0]);
                }
            }
        }
    }
}

/// Angles between flow and radius in a register.
struct Angle<S: Simd, T: Scalar> {
    flow: [Wide<S, T>; 2],
    used: Truths<S, T>,
    /// `|f|^2`, 1 where not used.
    square: Wide<S, T>,
    /// `|d|^2`, 1 where not used.
    radius_square: Wide<S, T>,
    /// `d . f`.
    along: Wide<S, T>,
    /// `d x f`.
    across: Wide<S, T>,
}

impl<S: Simd, T: Scalar> Angle<S, T> {
    #[inline(always)]
    fn of(simd: S, rows: &Rows<'_, T>, at: usize) -> Self {
        let (zero, one) = (splat(simd, 0.0), splat(simd, 1.0));
        let [u, v] = load2(simd, &rows.axial, at);
        let (x, y) = (Wide::load(simd, &rows.offset[at..]), Wide::splat(simd, rows.offset_v));
        let (square, radius_square) = (u * u + v * v, x * x + y * y);
        let used = zero.less(Wide::load(simd, &rows.weight[at..]).abs()) & zero.less(square) & zero.less(radius_square);
        let (square, radius_square) = (used.choose(square, one), used.choose(radius_square, one));
        Self { flow: [u, v], used, square, radius_square, along: u * x + v * y, across: x * v - y * u }
    }

    /// `d . f / (|d| |f|)`, held in [-1, 1].
    #[inline(always)]
    fn cosine(&self) -> Wide<S, T> {
        let one = self.along.like(T::ONE);
        (self.along / (self.square.sqrt() * self.radius_square.sqrt())).min(one).max(-one)
    }
}

/// Distances from the radial line in a register.
struct Distance<S: Simd, T: Scalar> {
    used: Truths<S, T>,
    offset: [Wide<S, T>; 2],
    /// `|d|`, at least `q_min`.
    radius: Wide<S, T>,
    distance: Wide<S, T>,
}

impl<S: Simd, T: Scalar> Distance<S, T> {
    #[inline(always)]
    fn of(simd: S, rows: &Rows<'_, T>, q_min: T, at: usize) -> Self {
        let [u, v] = load2(simd, &rows.axial, at);
        let (x, y) = (Wide::load(simd, &rows.offset[at..]), Wide::splat(simd, rows.offset_v));
        let (q_min, radius) = (Wide::splat(simd, q_min), (x * x + y * y).sqrt());
        let used = splat(simd, 0.0).less(Wide::load(simd, &rows.weight[at..]).abs()) & q_min.less(radius);
        let radius = radius.max(q_min);
        Self { used, offset: [x, y], radius, distance: (x * v - y * u) / radius }
    }
}
