//! Value and gradient of a band of rows, row after row through rings of scratch rows.
//!
//! The colours of row `r` complete the windows of row `r - 1`, and the windows of that row the gradients of row `r - 2`. Two rows
//! on either side of the band are computed for their neighbours.

use std::ops::Range;

use dimode_autodiff::Scalar;
use dimode_autodiff::simd::{Truths, Wide};
use pulp::{Simd, WithSimd};

use super::super::photometric::SHIFT;
use super::super::rows::{CHUNK, PAD, RING, clear_sides, cut, get, number, put, row, row_mut, rows_mut, stride};
use super::super::similarity::{Colours, Sums, Weights, add_row_pairs, add_rows, error_row, neighbours, spread_row};
use super::warp_rows::{MotionRow, WarpRow, WarpedRow, slots, turn};
use super::{CHANNELS, Combine};
use crate::taped::bands::Motion;

/// Size of an image and number of sources.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sizes {
    pub h: usize,
    pub w: usize,
    pub k: usize,
}

impl Sizes {
    /// Columns up to a whole chunk.
    pub fn columns(self) -> usize {
        self.w.next_multiple_of(CHUNK)
    }

    /// Rows of each part of [`Work`].
    fn parts(self) -> [usize; 8] {
        let colours = self.k * RING * CHANNELS;
        [3 * colours, 4 * self.k * RING, RING * CHANNELS, 5, 3 * self.k * CHANNELS, self.k, self.k * RING, 3 * colours]
    }

    /// Elements of scratch that a band needs.
    pub fn work(self) -> usize {
        self.parts().iter().sum::<usize>() * stride(self.w)
    }
}

/// What a band adds to the result.
#[derive(Clone, Debug)]
pub(super) struct BandSums {
    /// Sum of the errors.
    pub error: f64,
    /// Number of pixels that a warped source won.
    pub won: f64,
    /// Gradient of the sum of errors by each motion: rotation (9), translation (3).
    pub motions: Vec<[f64; 12]>,
}

impl BandSums {
    pub fn new(k: usize) -> Self {
        Self { error: 0.0, won: 0.0, motions: vec![[0.0; 12]; k] }
    }
}

/// Scratch rows; those of a ring stand at `row % RING`.
struct Work<'a, T> {
    /// Shifted colours of the sources and their slopes by u and v.
    colours: [&'a mut [T]; 3],
    /// [`MotionRow`]s.
    motion: &'a mut [T],
    /// Shifted colours of the target.
    target: &'a mut [T],
    /// Sums of three rows: y, yy, x, xx, xy.
    sums: &'a mut [T],
    /// Derivatives of the error of one row.
    partial: &'a mut [T],
    /// Errors of one row.
    error: &'a mut [T],
    /// Gradient of each source's error: 1 where it wins.
    winner: &'a mut [T],
    /// Derivatives of the winners' errors, spread over the columns of their windows.
    spread: &'a mut [T],
    stride: usize,
}

impl<'a, T> Work<'a, T> {
    fn new(sizes: Sizes, mut rest: &'a mut [T]) -> Self {
        let stride = stride(sizes.w);
        let [colours, motion, target, sums, partial, error, winner, spread] =
            sizes.parts().map(|rows| cut(&mut rest, rows * stride));
        let mut colours = colours.chunks_exact_mut(sizes.k * RING * CHANNELS * stride);
        let colours = std::array::from_fn(|_| colours.next().expect("three parts"));
        Work { colours, motion, target, sums, partial, error, winner, spread, stride }
    }
}

/// Place of a row of source `k` in a ring.
#[inline(always)]
fn ring(k: usize, row: usize) -> usize {
    k * RING + row % RING
}

/// Place of a row of channel `c` of source `k` in a ring.
#[inline(always)]
fn ring_of(k: usize, row: usize, c: usize) -> usize {
    ring(k, row) * CHANNELS + c
}

/// Where `error` is less than the best so far, or NaN: a NaN wins, so that it is seen.
#[inline(always)]
fn wins<S: Simd, T: Scalar>(error: Wide<S, T>, best: Wide<S, T>) -> Truths<S, T> {
    let zero = error.like(T::ZERO);
    error.less(best) | !(error.less(error.like(T::ONE)) | error.greater(zero))
}

/// The task of one band.
pub(super) struct Band<'a, T: Scalar> {
    pub sizes: Sizes,
    pub rows: Range<usize>,
    /// Whether a gradient is wanted.
    pub wanted: bool,
    pub combine: Combine,
    pub motions: &'a [Motion<T>],
    pub columns: &'a [T],
    pub rays: &'a [&'a [T]],
    pub depth: &'a [T],
    pub target: [&'a [T]; CHANNELS],
    pub sources: &'a [&'a [T]],
    pub identities: &'a [&'a [T]],
    pub work: &'a mut [T],
    /// Gradient of the depth, rows of the band.
    pub slope: &'a mut [T],
    pub sums: &'a mut BandSums,
}

impl<T: Scalar> WithSimd for Band<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let h = self.sizes.h;
        let mut work = Work::new(self.sizes, std::mem::take(&mut self.work));
        let whole = self.sizes.w.next_multiple_of(Wide::<S, T>::lanes());
        let Work { stride, .. } = work;
        // Windows read one column beyond either end, with weight 0.
        work.partial.chunks_exact_mut(stride).for_each(|row| clear_sides(row, whole));
        work.winner.chunks_exact_mut(stride).for_each(|row| clear_sides(row, self.sizes.w));
        let Range { start, end } = self.rows;
        let halo = if self.wanted { 1 } else { 0 };
        let wanted = self.wanted;
        let errors = start.saturating_sub(halo)..(end + halo).min(h);
        let colours = errors.start.saturating_sub(1)..(errors.end + 1).min(h);
        let slots = slots::<S, T>(simd);
        for r in colours {
            self.read_row(simd, &mut work, &slots, r);
            // The last row of the image has no row below that it must wait for.
            for q in (r.saturating_sub(1)..if r + 1 == h { h } else { r }).filter(|q| errors.contains(q)) {
                self.error_rows(simd, &mut work, q);
                let done = q.saturating_sub(1)..if q + 1 == h { h } else { q };
                for p in done.filter(|p| wanted && (start..end).contains(p)) {
                    for k in 0..self.sizes.k {
                        self.gradient_row(simd, &work, p, k);
                    }
                }
            }
        }
    }
}

impl<T: Scalar> Band<'_, T> {
    /// Colours of row `r`, of the target and of every warped source.
    #[inline(always)]
    fn read_row<S: Simd>(&self, simd: S, work: &mut Work<'_, T>, slots: &[u8; CHUNK], r: usize) {
        let Sizes { h, w, k } = self.sizes;
        let stride = work.stride;
        let shift = Wide::splat(simd, T::from_f64(SHIFT));
        for (c, y) in self.target.iter().enumerate() {
            let out = row_mut(work.target, r % RING * CHANNELS + c, stride);
            let y = &y[r * w..][..w];
            for j in (0..w).step_by(Wide::<S, T>::lanes()) {
                (get(simd, y, j) - shift).store(&mut out[PAD + j..]);
            }
        }
        for k in 0..k {
            let [colours, by_u, by_v] = work.colours.each_mut().map(|part| rows_mut(part, ring(k, r), stride));
            let [fu, fv, p, q] = rows_mut(work.motion, ring(k, r), stride);
            let mut out = WarpedRow { colours, by_u, by_v, motion: MotionRow { reach: [fu, fv], flow: [p, q] } };
            let task = WarpRow {
                motion: &self.motions[k],
                columns: self.columns,
                rays: self.rays[k],
                row: r,
                height: h,
                width: w,
                depth: &self.depth[r * w..][..w],
                image: self.sources[k],
                slots,
            };
            task.run(simd, &mut out);
        }
    }

    /// Errors of row `q`, who wins, and the spread derivatives of the winners.
    #[inline(always)]
    fn error_rows<S: Simd>(&mut self, simd: S, work: &mut Work<'_, T>, q: usize) {
        let Sizes { h, w, k: sources } = self.sizes;
        let stride = work.stride;
        let [above, below] = neighbours(q, h);
        for c in 0..CHANNELS {
            let y = [above, q, below].map(|i| row(work.target, i % RING * CHANNELS + c, stride));
            let [sy, syy, sx, sxx, sxy] = rows_mut(work.sums, 0, stride);
            add_rows(simd, y, w, [sy, syy]);
            for k in 0..sources {
                let x = [above, q, below].map(|i| row(work.colours[0], ring_of(k, i, c), stride));
                add_row_pairs(simd, (x, y), w, [sx, sxx, sxy]);
                let partial = self.wanted.then(|| rows_mut(work.partial, k * CHANNELS + c, stride));
                let error = row_mut(work.error, k, stride);
                let sums = Sums { x: sx, y: sy, xx: sxx, yy: syy, xy: sxy };
                error_row(simd, &sums, [x[1], y[1]], (w, CHANNELS, c == 0), error, partial);
            }
        }
        self.winners(simd, work, q);
        if !self.wanted {
            return;
        }
        for k in 0..sources {
            let gradient = row(work.winner, ring(k, q), stride);
            for c in 0..CHANNELS {
                for i in 0..3 {
                    let partial = row(work.partial, (k * CHANNELS + c) * 3 + i, stride);
                    let out = row_mut(work.spread, ring_of(k, q, c) * 3 + i, stride);
                    spread_row(simd, [partial, gradient], w, out);
                }
            }
        }
    }

    /// The gradients of the errors of row `q`, and the sum of the winners'.
    #[inline(always)]
    fn winners<S: Simd>(&mut self, simd: S, work: &mut Work<'_, T>, q: usize) {
        let Sizes { w, k: sources, .. } = self.sizes;
        let stride = work.stride;
        let (zero, one, width) = (number::<S, T>(simd, 0.0), number(simd, 1.0), number(simd, w as f64));
        let share = number(simd, 1.0 / sources as f64);
        let (mut errors, mut won) = (zero, zero);
        for j in (0..w).step_by(Wide::<S, T>::lanes()) {
            let seen = Wide::load(simd, &self.columns[j..]).less(width);
            let mut best = self.identity(simd, q * w..(q + 1) * w, j);
            let mut any = zero;
            if self.combine == Combine::Average {
                let mut mean = zero;
                for k in 0..sources {
                    mean = mean + Wide::load(simd, &row(work.error, k, stride)[PAD + j..]);
                }
                let mean = mean * share;
                let wins = wins(mean, best) & seen;
                best = wins.choose(mean, best);
                any = wins.choose(one, zero);
                for k in 0..sources {
                    wins.choose(share, zero).store(&mut row_mut(work.winner, ring(k, q), stride)[PAD + j..]);
                }
            } else {
                for k in 0..sources {
                    let error = Wide::load(simd, &row(work.error, k, stride)[PAD + j..]);
                    let wins = wins(error, best) & seen;
                    best = wins.choose(error, best);
                    any = wins.choose(one, any);
                    wins.choose(one, zero).store(&mut row_mut(work.winner, ring(k, q), stride)[PAD + j..]);
                    for before in 0..k {
                        let out = &mut row_mut(work.winner, ring(before, q), stride)[PAD + j..];
                        wins.choose(zero, Wide::load(simd, out)).store(out);
                    }
                }
            }
            errors = errors + seen.choose(best, zero);
            won = won + any;
        }
        if self.rows.contains(&q) {
            self.sums.error += errors.sum().to_f64();
            self.sums.won += won.sum().to_f64();
        }
    }

    /// What a warped source must undercut, in the register from column `j` on.
    #[inline(always)]
    fn identity<S: Simd>(&self, simd: S, row: Range<usize>, j: usize) -> Wide<S, T> {
        let Some((first, others)) = self.identities.split_first() else {
            return number(simd, f64::INFINITY);
        };
        let mut best = get(simd, &first[row.clone()], j);
        for map in others {
            let error = get(simd, &map[row.clone()], j);
            best = match self.combine {
                Combine::Minimum => wins(error, best).choose(error, best),
                Combine::Average => best + error,
            };
        }
        match self.combine {
            Combine::Minimum => best,
            Combine::Average => best * number(simd, 1.0 / self.identities.len() as f64),
        }
    }

    /// From the colours of source `k` in row `p` to the depth and its motion.
    #[inline(always)]
    fn gradient_row<S: Simd>(&mut self, simd: S, work: &Work<'_, T>, p: usize, k: usize) {
        let Sizes { h, w, .. } = self.sizes;
        let stride = work.stride;
        let m = &self.motions[k];
        let (zero, one) = (number::<S, T>(simd, 0.0), number(simd, 1.0));
        let y = m.ray_row(p);
        let weights = Weights::new(simd, p, h, CHANNELS);
        // A row that is not there has the weight 0.
        let window = [p.saturating_sub(1), p, (p + 1).min(h - 1)];
        let spread = |c: usize, i: usize| window.map(|r| row(work.spread, ring_of(k, r, c) * 3 + i, stride));
        let colours: [Colours<'_, T>; CHANNELS] = std::array::from_fn(|c| Colours {
            by_x: spread(c, 0),
            by_xx: spread(c, 1),
            by_xy: spread(c, 2),
            x: row(work.colours[0], ring_of(k, p, c), stride),
            y: row(work.target, p % RING * CHANNELS + c, stride),
        });
        let by_u: [&[T]; CHANNELS] = std::array::from_fn(|c| row(work.colours[1], ring_of(k, p, c), stride));
        let by_v: [&[T]; CHANNELS] = std::array::from_fn(|c| row(work.colours[2], ring_of(k, p, c), stride));
        let winner = row(work.winner, ring(k, p), stride);
        let [fu, fv, flow_u, flow_v]: [&[T]; 4] = std::array::from_fn(|i| row(work.motion, ring(k, p) * 4 + i, stride));
        let (rays, depth) = (self.rays[k], &self.depth[p * w..][..w]);
        let slope = &mut self.slope[(p - self.rows.start) * w..][..w];
        let mut to_turn = [[zero; 2]; 3];
        let mut to_t = [zero; 3];
        for j in (0..w).step_by(Wide::<S, T>::lanes()) {
            let i = PAD + j;
            let gradient = Wide::load(simd, &winner[i..]);
            let (mut gu, mut gv) = (zero, zero);
            for c in 0..CHANNELS {
                let g = colours[c].gradient(simd, i, weights, gradient);
                gu = g.mul_add(Wide::load(simd, &by_u[c][i..]), gu);
                gv = g.mul_add(Wide::load(simd, &by_v[c][i..]), gv);
            }
            let (fu, fv) = (Wide::load(simd, &fu[i..]), Wide::load(simd, &fv[i..]));
            let (free_u, free_v) = (fu.greater(zero), fv.greater(zero));
            // Colours read at no place are NaN.
            let (a, b) = (free_u.choose(gu * fu, zero), free_v.choose(gv * fv, zero));
            let c = -(a * Wide::load(simd, &flow_u[i..]) + b * Wide::load(simd, &flow_v[i..]));
            let z = (free_u | free_v).choose(get(simd, depth, j), zero);
            let x = Wide::load(simd, &rays[j..]);
            let [e0, e1, e2] = [turn(simd, m, 0, x, y), turn(simd, m, 1, x, y), turn(simd, m, 2, x, y)];
            let y = Wide::splat(simd, y);
            let s = c - a * x - b * y;
            let to_z = a * (e0 - x * e2) + b * (e1 - y * e2) + c * (one + e2);
            let to_z = if k == 0 { to_z } else { to_z + get(simd, slope, j) };
            put(to_z, slope, j);
            let parts = [a, b, s];
            for i in 0..3 {
                let turned = parts[i] * z;
                to_t[i] = to_t[i] + parts[i];
                to_turn[i][0] = turned.mul_add(x, to_turn[i][0]);
                to_turn[i][1] = to_turn[i][1] + turned;
            }
        }
        let sums = &mut self.sums.motions[k];
        for i in 0..3 {
            let whole = to_turn[i][1].sum().to_f64();
            sums[3 * i] += to_turn[i][0].sum().to_f64();
            sums[3 * i + 1] += whole * y.to_f64();
            sums[3 * i + 2] += whole;
            sums[9 + i] += to_t[i].sum().to_f64();
        }
    }
}
