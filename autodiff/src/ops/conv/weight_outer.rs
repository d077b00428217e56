//! The weight gradient of several output channels: at every position, the output gradients of a strip of channels times the
//! input that a tap reads there. No sum over lanes is left at the end, and positions beyond the image are never visited.

use pulp::{Arch, Simd, WithSimd};

use crate::Scalar;

/// Output channels side by side in memory.
pub const STRIP: usize = 16;
/// Positions that all pairs visit before the next ones are read, about; registers are flushed to `f64` between.
const TILE: usize = 1024;

/// Sums over all positions of the output gradients of a strip times the inputs of some (input channel, tap) pairs.
#[derive(Clone, Copy)]
pub struct WeightOuter<'a, T> {
    /// Output gradients of the strip, `[image][row][column][STRIP]`, zeros beyond the last channel.
    pub g: &'a [T],
    /// Packed input of one group: image `n` starts at `n * x_image`, rows are `x_row` apart.
    pub x: &'a [T],
    pub x_image: usize,
    pub x_row: usize,
    /// Offset of every (input channel, tap) pair within an image.
    pub pairs: &'a [usize],
    /// Images, rows and columns of the output.
    pub size: [usize; 3],
}

impl<T: Scalar> WeightOuter<'_, T> {
    /// The sums, `[pair][STRIP]`.
    pub fn run(self) -> Vec<f64> {
        let mut sums = vec![0.0; self.pairs.len() * STRIP];
        Arch::new().dispatch(Run { task: self, sums: &mut sums });
        sums
    }
}

struct Run<'a, 'b, T> {
    task: WeightOuter<'a, T>,
    sums: &'b mut [f64],
}

impl<T: Scalar> WithSimd for Run<'_, '_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let lanes = T::lanes::<S>();
        let [images, rows, cols] = self.task.size;
        let (lines, step) = (images * rows, TILE.div_ceil(cols));
        for first in (0..lines).step_by(step) {
            let tile = Tile { task: &self.task, first, last: lines.min(first + step) };
            let (count, mut at) = (self.task.pairs.len(), 0);
            if lanes == STRIP {
                while at < count {
                    at += match count - at {
                        12.. => block::<T, S, 1, 12>(&tile, simd, 0, at, self.sums),
                        3.. => block::<T, S, 1, 3>(&tile, simd, 0, at, self.sums),
                        _ => block::<T, S, 1, 1>(&tile, simd, 0, at, self.sums),
                    };
                }
                continue;
            }
            // Shorter registers: two at a time.
            for lane in (0..STRIP).step_by(2 * lanes) {
                at = 0;
                while at < count {
                    at += match count - at {
                        6.. => block::<T, S, 2, 6>(&tile, simd, lane, at, self.sums),
                        _ => block::<T, S, 2, 1>(&tile, simd, lane, at, self.sums),
                    };
                }
            }
        }
    }
}

/// Rows of output, counted through all images.
struct Tile<'a, T> {
    task: &'a WeightOuter<'a, T>,
    first: usize,
    last: usize,
}

/// `P` pairs from `at` on, `V` registers of channels from `lane` on. Returns `P`.
#[inline(always)]
fn block<T: Scalar, S: Simd, const V: usize, const P: usize>(
    tile: &Tile<'_, T>,
    simd: S,
    lane: usize,
    at: usize,
    sums: &mut [f64],
) -> usize {
    let t = tile.task;
    let [_, rows, cols] = t.size;
    let mut acc = [[T::splat(simd, T::ZERO); V]; P];
    for line in tile.first..tile.last {
        let from = line / rows * t.x_image + line % rows * t.x_row;
        let mut starts = [0; P];
        for (start, pair) in starts.iter_mut().zip(&t.pairs[at..at + P]) {
            *start = from + pair;
        }
        let g = &t.g[line * cols * STRIP..][..cols * STRIP];
        let mut i = 0;
        while i + 4 <= cols {
            positions::<T, S, V, P, 4>(t.x, simd, &g[i * STRIP + lane..], &starts, i, &mut acc);
            i += 4;
        }
        while i < cols {
            positions::<T, S, V, P, 1>(t.x, simd, &g[i * STRIP + lane..], &starts, i, &mut acc);
            i += 1;
        }
    }
    flush::<T, S, V, P>(lane, &acc, &mut sums[at * STRIP..][..P * STRIP]);
    P
}

/// Adds the products of `C` neighbouring positions.
#[inline(always)]
fn positions<T: Scalar, S: Simd, const V: usize, const P: usize, const C: usize>(
    x: &[T],
    simd: S,
    g: &[T],
    starts: &[usize; P],
    i: usize,
    acc: &mut [[T::Reg<S>; V]; P],
) {
    let lanes = T::lanes::<S>();
    let mut gs = [[T::splat(simd, T::ZERO); V]; C];
    for (c, gs) in gs.iter_mut().enumerate() {
        for (v, g_v) in gs.iter_mut().enumerate() {
            *g_v = T::load::<S>(&g[c * STRIP + v * lanes..]);
        }
    }
    for (start, acc) in starts.iter().zip(acc) {
        let x = &x[start + i..][..C];
        for (&x, gs) in x.iter().zip(&gs) {
            let x = T::splat(simd, x);
            for (acc, &g) in acc.iter_mut().zip(gs) {
                *acc = T::fma(simd, x, g, *acc);
            }
        }
    }
}

#[inline(always)]
fn flush<T: Scalar, S: Simd, const V: usize, const P: usize>(lane: usize, acc: &[[T::Reg<S>; V]; P], sums: &mut [f64]) {
    let lanes = T::lanes::<S>();
    let mut values = [T::ZERO; STRIP];
    for (acc, sums) in acc.iter().zip(sums.chunks_exact_mut(STRIP)) {
        for (v, acc) in acc.iter().enumerate() {
            T::store::<S>(&mut values, *acc);
            for (sum, value) in sums[lane + v * lanes..][..lanes].iter_mut().zip(&values) {
                *sum += value.to_f64();
            }
        }
    }
}
