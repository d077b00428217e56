//! Value and gradient of the smoothness in a band of rows.

use std::ops::Range;

use dimode_autodiff::Scalar;
use dimode_autodiff::simd::Wide;
use pulp::{Simd, WithSimd};

use super::super::rows::{PAD, clear_sides, get, number, put, rows_mut, stride};

/// What a band adds to the result.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct BandSums {
    /// Weighted differences, divided by their number.
    pub edges: f64,
    /// Sum of the map.
    pub total: f64,
}

/// The task of one band of one plane.
pub(super) struct Band<'a, T> {
    pub h: usize,
    pub w: usize,
    pub rows: Range<usize>,
    pub map: &'a [T],
    /// All colours of the image, plane after plane.
    pub image: &'a [T],
    /// Factor of the sum of absolute colour differences in the exponent.
    pub edge: f64,
    /// Factors of differences along rows (to the next row) and columns.
    pub shares: [f64; 2],
    pub work: &'a mut [T],
    /// Gradient, rows of the band.
    pub slope: &'a mut [T],
    pub sums: &'a mut BandSums,
}

impl<T> Band<'_, T> {
    /// Elements of scratch that a band of this width needs.
    pub fn work(width: usize) -> usize {
        3 * stride(width)
    }
}

impl<T: Scalar> WithSimd for Band<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (h, w, plane) = (self.h, self.w, self.h * self.w);
        let [across, down, above] = rows_mut(self.work, 0, stride(w));
        let edge = number(simd, self.edge);
        let [share_down, share_across] = self.shares.map(|x| number::<S, T>(simd, x));
        let (zero, width) = (number::<S, T>(simd, 0.0), w - 1);
        let Range { start, end } = self.rows;
        above.fill(T::ZERO);
        for i in start.saturating_sub(1)..end {
            let row = &self.map[i * w..][..w];
            let next = if i + 1 < h { &self.map[(i + 1) * w..][..w] } else { row };
            // Exponents of both weights. Behind the last column there is nothing.
            for j in (0..w).step_by(Wide::<S, T>::lanes()) {
                let (mut to_right, mut to_below) = (zero, zero);
                for colour in self.image.chunks_exact(plane) {
                    let row = &colour[i * w..][..w];
                    let next = if i + 1 < h { &colour[(i + 1) * w..][..w] } else { row };
                    let here = get(simd, row, j);
                    to_right = to_right + (get(simd, row, j + 1) - here).abs();
                    to_below = to_below + (get(simd, next, j) - here).abs();
                }
                (edge * to_right).store(&mut across[PAD + j..]);
                (edge * to_below).store(&mut down[PAD + j..]);
            }
            across[PAD..PAD + w].iter_mut().for_each(|x| *x = x.exp());
            down[PAD..PAD + w].iter_mut().for_each(|x| *x = x.exp());
            clear_sides(across, width);
            clear_sides(down, w);
            let inside = i >= start;
            let (mut sum_across, mut sum_down, mut total) = (zero, zero, zero);
            for j in (0..w).step_by(Wide::<S, T>::lanes()) {
                let here = get(simd, row, j);
                let step = get(simd, row, j + 1) - here;
                let weight = Wide::load(simd, &across[PAD + j..]);
                sum_across = sum_across + weight * step.abs();
                signed(weight, step).store(&mut across[PAD + j..]);
                // On the last row the step is 0.
                let step = get(simd, next, j) - here;
                let weight = Wide::load(simd, &down[PAD + j..]);
                sum_down = sum_down + weight * step.abs();
                signed(weight, step).store(&mut down[PAD + j..]);
                total = total + here;
            }
            if inside {
                let slope = &mut self.slope[(i - start) * w..][..w];
                for j in (0..w).step_by(Wide::<S, T>::lanes()) {
                    let at = PAD + j;
                    let along = Wide::load(simd, &across[at - 1..]) - Wide::load(simd, &across[at..]);
                    let beyond = Wide::load(simd, &above[at..]) - Wide::load(simd, &down[at..]);
                    put(along * share_across + beyond * share_down, slope, j);
                }
                let [down, across] = self.shares;
                self.sums.edges += sum_across.sum().to_f64() * across + sum_down.sum().to_f64() * down;
                self.sums.total += total.sum().to_f64();
            }
            above.copy_from_slice(down);
        }
    }
}

/// The weight with the sign of the step; 0 where there is none.
#[inline(always)]
fn signed<S: Simd, T: Scalar>(weight: Wide<S, T>, step: Wide<S, T>) -> Wide<S, T> {
    let zero = weight.like(T::ZERO);
    step.greater(zero).choose(weight, step.less(zero).choose(-weight, zero))
}
