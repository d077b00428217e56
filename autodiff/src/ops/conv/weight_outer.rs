//! The weight gradient of several output channels: at every position, the output gradients of a strip of channels times the input
//! that a tap reads there. No sum over lanes is left at the end, and positions beyond the image are never visited.

use pulp::{Arch, Simd, WithSimd};

use crate::Scalar;
use crate::simd::unroll;

/// Most output channels side by side in memory; a strip has so many, or half of them.
pub const STRIP: usize = 32;
/// Positions that all pairs visit before the next ones are read, about; registers are flushed to `f64` between.
const TILE: usize = 256;

/// Sums over some rows of the output gradients of a strip times the inputs of some (input channel, tap) pairs.
pub struct WeightOuter<'a, T> {
    /// Output gradients, `[image][row][column][width]`, zeros beyond the last channel.
    pub g: &'a [T],
    /// Channels of the strip, `STRIP` or half of it.
    pub width: usize,
    /// Packed input of one group: image `n` starts at `n * x_image`, rows are `x_row` apart.
    pub x: &'a [T],
    pub x_image: usize,
    pub x_row: usize,
    /// Offset of every (input channel, tap) pair within an image.
    pub pairs: &'a [usize],
    /// Images, rows and columns of the output.
    pub size: [usize; 3],
    /// Rows to visit, counted through all images.
    pub lines: std::ops::Range<usize>,
    /// `[pair][width]`, to be added to.
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
                while at < t.pairs.len() {
                    at += match (t.pairs.len() - at, two, many) {
                        (10.., true, true) => block::<T, S, 2, 10>(t, simd, lines, lane, at),
                        (6.., true, _) => block::<T, S, 2, 6>(t, simd, lines, lane, at),
                        (3.., true, _) => block::<T, S, 2, 3>(t, simd, lines, lane, at),
                        (_, true, _) => block::<T, S, 2, 1>(t, simd, lines, lane, at),
                        (24.., false, true) => block::<T, S, 1, 24>(t, simd, lines, lane, at),
                        (9.., false, _) => block::<T, S, 1, 9>(t, simd, lines, lane, at),
                        (3.., false, _) => block::<T, S, 1, 3>(t, simd, lines, lane, at),
                        (_, false, _) => block::<T, S, 1, 1>(t, simd, lines, lane, at),
                    };
                }
                lane += if two { 2 * lanes } else { lanes };
            }
        }
    }
}

/// `P` pairs from `at` on, `V` registers of channels from `lane` on. Returns `P`.
#[inline(always)]
fn block<T: Scalar, S: Simd, const V: usize, const P: usize>(
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
        let xs: [&[T]; P] = std::array::from_fn(|p| &x[t.pairs[at + p]..][..cols]);
        // A position has `width / lanes` registers.
        let gs = T::registers::<S>(&t.g[line * cols * width..][..cols * width]).chunks_exact(width / lanes);
        for (j, g) in (0..cols).zip(gs) {
            let g = &g[lane / lanes..][..V];
            unroll!(K in 0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22 23 => {
                if K < P {
                    let x = T::splat(simd, xs[K][j]);
                    unroll!(L in 0 1 => {
                        if L < V {
                            acc[K][L] = T::fma(simd, g[L], x, acc[K][L]);
                        }
                    });
                }
            });
        }
    }
    let mut row = [T::ZERO; STRIP];
    unroll!(K in 0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22 23 => {
        if K < P {
            unroll!(L in 0 1 => {
                if L < V {
                    T::store::<S>(&mut row, acc[K][L]);
                    let sums = &mut t.sums[(at + K) * width + lane + L * lanes..][..lanes];
                    for (sum, x) in sums.iter_mut().zip(row) {
                        *sum += x.to_f64();
                    }
                }
            });
        }
    });
    P
}
