//! The weight gradient of several output channels: at every position, the output gradients of a strip of channels times the input
//! that a tap reads there. No sum over lanes is left at the end, and positions beyond the image are never visited.

use pulp::{Arch, Simd, WithSimd};

use crate::Scalar;
use crate::simd::unroll;

/// Most output channels side by side in memory; a strip has so many, or half of them.
pub const STRIP: usize = 32;
/// Positions that all runs visit before the next ones are read, about; registers are flushed to `f64` between.
const TILE: usize = 256;
/// Taps that are summed at one time, at most.
const MOST: usize = 24;

/// Sums over some rows of the output gradients of a strip times the inputs of some runs of taps.
pub struct WeightOuter<'a, T> {
    /// Output gradients, `[image][row][column][width]`, zeros beyond the last channel.
    pub g: &'a [T],
    /// Channels of the strip, `STRIP` or half of it.
    pub width: usize,
    /// Packed input of one group: image `n` starts at `n * x_image`, rows are `x_row` apart.
    pub x: &'a [T],
    pub x_image: usize,
    pub x_row: usize,
    /// Offset of every run of taps within an image: a run is one tap, or three that read side by side.
    pub runs: &'a [usize],
    pub taps: usize,
    /// Images, rows and columns of the output.
    pub size: [usize; 3],
    /// Rows to visit, counted through all images.
    pub lines: std::ops::Range<usize>,
    /// `[run][tap][width]`, to be added to.
    pub sums: &'a mut [f64],
}

impl<T: Scalar> WeightOuter<'_, T> {
    /// Runs the kernel on the processor's widest registers.
    pub fn run(self) {
        Arch::new().dispatch(self);
    }
}

impl<T: Scalar> WithSimd for WeightOuter<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let lanes = T::lanes::<S>();
        let t = &mut self;
        // 32 registers with the widest ones, else 16.
        let many = lanes * size_of::<T>() == 64;
        let (step, width) = (TILE.div_ceil(t.size[2]), t.width);
        let lines = t.lines.clone();
        for first in lines.clone().step_by(step) {
            let lines = [first, lines.end.min(first + step)];
            let mut lane = 0;
            while lane < width {
                let two = lane + 2 * lanes <= width;
                let mut at = 0;
                while at < t.runs.len() {
                    at += match (t.taps, t.runs.len() - at, two, many) {
                        (3, 2.., true, _) => block::<T, S, 2, 6, 3>(t, simd, lines, lane, at),
                        (3, _, true, _) => block::<T, S, 2, 3, 3>(t, simd, lines, lane, at),
                        (3, 8.., false, true) => block::<T, S, 1, 24, 3>(t, simd, lines, lane, at),
                        (3, 3.., false, _) => block::<T, S, 1, 9, 3>(t, simd, lines, lane, at),
                        (3, _, false, _) => block::<T, S, 1, 3, 3>(t, simd, lines, lane, at),
                        (_, 10.., true, true) => block::<T, S, 2, 10, 1>(t, simd, lines, lane, at),
                        (_, 6.., true, _) => block::<T, S, 2, 6, 1>(t, simd, lines, lane, at),
                        (_, 3.., true, _) => block::<T, S, 2, 3, 1>(t, simd, lines, lane, at),
                        (_, _, true, _) => block::<T, S, 2, 1, 1>(t, simd, lines, lane, at),
                        (_, 24.., false, true) => block::<T, S, 1, 24, 1>(t, simd, lines, lane, at),
                        (_, 9.., false, _) => block::<T, S, 1, 9, 1>(t, simd, lines, lane, at),
                        (_, 3.., false, _) => block::<T, S, 1, 3, 1>(t, simd, lines, lane, at),
                        (_, _, false, _) => block::<T, S, 1, 1, 1>(t, simd, lines, lane, at),
                    };
                }
                lane += if two { 2 * lanes } else { lanes };
            }
        }
    }
}

/// `P` taps in runs of `K` from run `at` on, `V` registers of channels from `lane` on. Returns the number of runs.
#[inline(always)]
fn block<T: Scalar, S: Simd, const V: usize, const P: usize, const K: usize>(
    t: &mut WeightOuter<'_, T>,
    simd: S,
    lines: [usize; 2],
    lane: usize,
    at: usize,
) -> usize {
    let lanes = T::lanes::<S>();
    let [_, rows, cols] = t.size;
    let width = t.width;
    let mut acc = [[T::splat(simd, T::ZERO); V]; P];
    for line in lines[0]..lines[1] {
        let (n, row) = (line / rows, line % rows);
        let x = &t.x[n * t.x_image + row * t.x_row..];
        // One pointer to a run: the processor has too few for one to a tap.
        let rows: [&[T]; MOST] = std::array::from_fn(|r| if r < P / K { &x[t.runs[at + r]..][..cols + K - 1] } else { &x[..0] });
        let xs: [&[T]; P] = std::array::from_fn(|p| &rows[p / K][p % K..][..cols]);
        // A position has `width / lanes` registers.
        let gs = T::registers::<S>(&t.g[line * cols * width..][..cols * width]).chunks_exact(width / lanes);
        for (j, g) in (0..cols).zip(gs) {
            let g = &g[lane / lanes..][..V];
            unroll!(M in 0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22 23 => {
                if M < P {
                    let x = T::splat(simd, xs[M][j]);
                    unroll!(L in 0 1 => {
                        if L < V {
                            acc[M][L] = T::fma(simd, g[L], x, acc[M][L]);
                        }
                    });
                }
            });
        }
    }
    let mut row = [T::ZERO; STRIP];
    unroll!(M in 0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22 23 => {
        if M < P {
            unroll!(L in 0 1 => {
                if L < V {
                    T::store::<S>(&mut row, acc[M][L]);
                    let sums = &mut t.sums[(at * K + M) * width + lane + L * lanes..][..lanes];
                    for (sum, x) in sums.iter_mut().zip(row) {
                        *sum += x.to_f64();
                    }
                }
            });
        }
    });
    P / K
}
