//! `L_pla`, see [`planar`](crate::losses::planar()).
//!
//! - Variance of the angle `arccos(f_u / |f|)`: its slope by the flow is `(-|f_v|, sign(f_v) f_u) / |f|^2`, taken as 0 where the
//!   cosine is 1 to rounding; that of the variance by an angle `2 w (angle - mean) / sum w`.
//! - Distance `f_u d_v - f_v d_u` from the line along the predicted direction `d`.

use dimode_autodiff::Scalar;
use dimode_autodiff::simd::{Simd, Truths, Wide};

use super::residual::Beyond;
use super::rows::{COUNT, Rows, Sample, Sums, WEIGHT, add, add_sums, load2, splat};
use crate::losses::{LossOptions, PlanarForm};

/// The loss of one sample.
pub(super) enum Planar<T> {
    /// As printed.
    Literal,
    /// In pixels.
    Pixels(Line<T>),
}

/// The predicted direction of planar flows.
pub(super) struct Line<T> {
    direction: [T; 2],
    /// `f o a_tan` and its length.
    vector: [T; 2],
    size: T,
    /// Whether enough of the translation is tangential.
    usable: bool,
    /// Shortest predicted flow that counts, pixels.
    shortest: T,
    smooth: T,
    detached: bool,
}

/// Smallest length that a direction is divided by.
const GUARD: f64 = 1e-12;

impl<T: Scalar> Planar<T> {
    /// `None` for the other forms.
    pub(super) fn new(options: &LossOptions, sample: &Sample<T>) -> Option<Self> {
        match options.planar {
            PlanarForm::Literal => Some(Self::Literal),
            PlanarForm::PerpendicularPixels => Some(Self::Pixels(Line::new(options, sample))),
            PlanarForm::Robust | PlanarForm::Circular | PlanarForm::Weighted => None,
        }
    }

    /// Adds the sums of a row.
    #[inline(always)]
    pub(super) fn sum<S: Simd>(&self, simd: S, sample: &Sample<T>, rows: &Rows<'_, T>, sums: &mut Sums) {
        let zero = splat(simd, 0.0);
        let mut totals = [zero; 4];
        let step = Wide::<S, T>::lanes();
        match self {
            Self::Literal => {
                for at in (0..rows.padded()).step_by(step) {
                    let p = Direction::of(simd, rows, at);
                    let angle = p.cosine.arccos();
                    let w = p.used.choose(Wide::load(simd, &rows.weight[at..]), zero);
                    add_pixel(&mut totals, p.used, w);
                    totals[2] = w.mul_add(angle, totals[2]);
                    totals[3] = (w * angle).mul_add(angle, totals[3]);
                }
            }
            Self::Pixels(line) => {
                let beyond = Beyond::new(simd, sample, line.smooth);
                for at in (0..rows.padded()).step_by(step) {
                    let used = line.used(simd, rows, at);
                    let distance = line.distance(simd, rows, at);
                    let w = used.choose(Wide::load(simd, &rows.weight[at..]), zero);
                    add_pixel(&mut totals, used, w);
                    totals[2] = w.mul_add(beyond.of(simd, distance * distance, rows, at).value, totals[2]);
                }
            }
        }
        add_sums(sums, totals);
    }

    /// The loss.
    pub(super) fn value(&self, sums: &Sums) -> f64 {
        if sums[WEIGHT] == 0.0 {
            return 0.0;
        }
        let mean = sums[2] / sums[WEIGHT];
        match self {
            Self::Literal => (sums[3] / sums[WEIGHT] - mean * mean).max(0.0),
            Self::Pixels(_) => mean,
        }
    }

    /// Adds the gradients of a row to its planar flows, and those of the direction to its sums.
    #[inline(always)]
    pub(super) fn spread<S: Simd>(
        &self,
        simd: S,
        sample: &Sample<T>,
        (g, sums): (f64, &Sums),
        rows: &mut Rows<'_, T>,
        to_direction: &mut [f64; 2],
    ) {
        if g == 0.0 || sums[WEIGHT] == 0.0 {
            return;
        }
        let zero = splat(simd, 0.0);
        let share = g / sums[WEIGHT];
        let step = Wide::<S, T>::lanes();
        match self {
            Self::Literal => {
                let (share, mean) = (splat(simd, 2.0 * share), splat(simd, sums[2] / sums[WEIGHT]));
                for at in (0..rows.padded()).step_by(step) {
                    let p = Direction::of(simd, rows, at);
                    let [u, v] = p.flow;
                    let slopes = p.used & zero.less(v.abs()) & p.cosine.abs().less(p.cosine.like(T::ONE));
                    let from_angle = share * Wide::load(simd, &rows.weight[at..]) * (p.cosine.arccos() - mean);
                    let from_angle = slopes.choose(from_angle * p.inverse * p.inverse, zero);
                    add(simd, rows.to_planar[0], at, -(from_angle * v.abs()));
                    add(simd, rows.to_planar[1], at, from_angle * v.less(zero).choose(-u, u));
                }
            }
            Self::Pixels(line) => {
                let beyond = Beyond::new(simd, sample, line.smooth);
                let share = splat(simd, share);
                let [x, y] = [Wide::splat(simd, line.direction[0]), Wide::splat(simd, line.direction[1])];
                let mut totals = [zero; 2];
                for at in (0..rows.padded()).step_by(step) {
                    let used = line.used(simd, rows, at);
                    let distance = line.distance(simd, rows, at);
                    let excess = beyond.of(simd, distance * distance, rows, at);
                    let s = (used & excess.counts).choose(share * Wide::load(simd, &rows.weight[at..]), zero);
                    beyond.send(simd, rows, at, s);
                    let s = s * distance / excess.length;
                    let [u, v] = load2(simd, &rows.planar, at);
                    add(simd, rows.to_planar[0], at, s * y);
                    add(simd, rows.to_planar[1], at, -(s * x));
                    totals = [totals[0] - s * v, s.mul_add(u, totals[1])];
                }
                add_sums(to_direction, totals);
            }
        }
    }

    /// Gradient of `a` from that of the direction.
    pub(super) fn to_translation(&self, sample: &Sample<T>, to_direction: [f64; 2]) -> [f64; 3] {
        match self {
            Self::Pixels(line) if !line.detached => {
                let ([x, y], size) = (line.vector.map(T::to_f64), line.size.to_f64());
                let focal = [sample.motion.fu, sample.motion.fv].map(T::to_f64);
                let [gx, gy] = to_direction;
                if size < GUARD {
                    return [focal[0] * gx / GUARD, focal[1] * gy / GUARD, 0.0];
                }
                let along = (gx * x + gy * y) / (size * size);
                [focal[0] * (gx - along * x) / size, focal[1] * (gy - along * y) / size, 0.0]
            }
            _ => [0.0; 3],
        }
    }
}

/// Adds to the weight and the number of pixels.
#[inline(always)]
pub(super) fn add_pixel<S: Simd, T: Scalar, const K: usize>(totals: &mut [Wide<S, T>; K], used: Truths<S, T>, w: Wide<S, T>) {
    totals[WEIGHT] = totals[WEIGHT] + w;
    totals[COUNT] = totals[COUNT] + used.choose(w.like(T::ONE), w.like(T::ZERO));
}

/// Direction of the planar flows of a register.
struct Direction<S: Simd, T: Scalar> {
    flow: [Wide<S, T>; 2],
    used: Truths<S, T>,
    /// `1 / |f|`, 1 where not used.
    inverse: Wide<S, T>,
    /// `f_u / |f|`.
    cosine: Wide<S, T>,
}

impl<S: Simd, T: Scalar> Direction<S, T> {
    #[inline(always)]
    fn of(simd: S, rows: &Rows<'_, T>, at: usize) -> Self {
        let (zero, one) = (splat(simd, 0.0), splat(simd, 1.0));
        let [u, v] = load2(simd, &rows.planar, at);
        let square = u * u + v * v;
        let used = zero.less(Wide::load(simd, &rows.weight[at..]).abs()) & zero.less(square);
        let inverse = one / used.choose(square, one).sqrt();
        // A horizontal flow has no angle, not even by the rounding of the reciprocal.
        let horizontal = u.less(zero).choose(-one, one);
        let cosine = zero.less(v.abs()).choose((u * inverse).min(one).max(-one), horizontal);
        Self { flow: [u, v], used, inverse, cosine }
    }
}

impl<T: Scalar> Line<T> {
    fn new(options: &LossOptions, sample: &Sample<T>) -> Self {
        let m = &sample.motion;
        let vector = [m.fu * m.t[0], m.fv * m.t[1]];
        let size = (vector[0] * vector[0] + vector[1] * vector[1]).sqrt();
        let [x, y, z] = m.t.map(T::to_f64);
        Self {
            direction: vector.map(|c| c / size.max(T::from_f64(GUARD))),
            vector,
            size,
            usable: x.hypot(y) >= options.min_tangential_share * x.hypot(y).hypot(z),
            shortest: T::from_f64(options.min_tangential_flow),
            smooth: T::from_f64(options.smooth_pixels),
            detached: options.detach_direction,
        }
    }

    /// Pixels whose predicted flow is long enough.
    #[inline(always)]
    fn used<S: Simd>(&self, simd: S, rows: &Rows<'_, T>, at: usize) -> Truths<S, T> {
        let size = Wide::splat(simd, if self.usable { self.size } else { T::NEG_INFINITY });
        let long = (Wide::splat(simd, self.shortest) * Wide::load(simd, &rows.target_depth[at..])).less(size);
        splat(simd, 0.0).less(Wide::load(simd, &rows.weight[at..]).abs()) & long
    }

    /// Signed distance of the planar flow from the line.
    #[inline(always)]
    fn distance<S: Simd>(&self, simd: S, rows: &Rows<'_, T>, at: usize) -> Wide<S, T> {
        let [u, v] = load2(simd, &rows.planar, at);
        u * Wide::splat(simd, self.direction[1]) - v * Wide::splat(simd, self.direction[0])
    }
}
