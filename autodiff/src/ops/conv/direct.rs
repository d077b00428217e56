//! The direct product: a block of output channels as sums of shifted input planes times broadcast weights, in registers.

use pulp::{Arch, Simd, WithSimd};

use crate::Scalar;
use crate::simd::unroll;

/// Output channels of a full block.
pub const BLOCK: usize = 8;
/// Products of one output after which partial sums are put down, so that what is read again and again stays in the nearest cache.
const PRODUCTS: usize = 144;

/// Output channels `start .. start + width` of one group, as wide as the register block allows.
#[derive(Clone, Copy, Debug)]
pub struct OutputBlock {
    pub start: usize,
    pub width: usize,
}

/// Cuts `channels` into blocks of 8, then 4, 2, 1.
pub fn blocks(channels: usize) -> Vec<OutputBlock> {
    let mut out = Vec::new();
    let mut start = 0;
    for width in [BLOCK, 4, 2, 1] {
        while channels - start >= width {
            out.push(OutputBlock { start, width });
            start += width;
        }
    }
    out
}

/// One tap of the kernel.
#[derive(Clone, Copy, Debug)]
pub struct Tap {
    /// Where it reads, from the output's position, within a channel.
    pub offset: usize,
    /// Its weight, among those of one input and output channel.
    pub weight: usize,
}

/// One block of outputs at positions `0..len` of some rows: `out[lane][pos] = sum over channels and taps of w * x`, and a bias.
pub struct Direct<'a, 'b, T> {
    /// Input planes; channel `c` starts at `c * channel_len`.
    pub x: &'a [T],
    pub channel_len: usize,
    /// Input channels.
    pub channels: usize,
    /// Weights as they are: that of the block's output `o`, channel `c`, tap `t` is at
    /// `o * output_stride + c * channel_stride + t.weight`.
    pub weights: &'a [T],
    pub output_stride: usize,
    pub channel_stride: usize,
    pub taps: &'a [Tap],
    /// Weights of one input and output channel, all of which may not be among `taps`.
    pub kernel: usize,
    /// Rows wanted, and positions of each.
    pub rows: usize,
    pub len: usize,
    /// From one row to the next, of `x` and of `out`.
    pub pitches: [usize; 2],
    /// The block's channels, 8, 4, 2 or 1: `padded_len(len)` elements in a row.
    pub out: &'a mut [&'b mut [T]],
    /// What is added at last to each channel of the block; nothing where it is empty.
    pub bias: &'a [T],
    /// Whether to add to `out` rather than to fill it.
    pub add: bool,
}

/// `len` rounded up so that whole registers can be stored.
pub fn padded_len(len: usize) -> usize {
    len.div_ceil(16) * 16
}

/// The channels of a block that follow each other.
pub fn split<T>(channels: &mut [T], width: usize) -> [&mut [T]; BLOCK] {
    let mut out: [&mut [T]; BLOCK] = Default::default();
    let len = channels.len() / width;
    out.iter_mut().zip(channels.chunks_exact_mut(len)).for_each(|(out, channel)| *out = channel);
    out
}

impl<T: Scalar> Direct<'_, '_, T> {
    /// Runs the kernel on the processor's widest registers.
    pub fn run(self) {
        Arch::new().dispatch(self);
    }
}

impl<T: Scalar> WithSimd for Direct<'_, '_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let d = &mut self;
        // 32 registers with the widest ones, else 16.
        let many = T::lanes::<S>() * size_of::<T>() == 64;
        let some = (PRODUCTS / d.taps.len()).clamp(16, 32);
        for first in (0..d.channels).step_by(some) {
            let channels = [first, d.channels.min(first + some)];
            match (d.out.len(), many) {
                (8, true) => sweep::<T, S, 8, 3>(d, simd, 0, channels),
                (4, true) => sweep::<T, S, 4, 5>(d, simd, 0, channels),
                (2, true) => sweep::<T, S, 2, 8>(d, simd, 0, channels),
                (1, true) => sweep::<T, S, 1, 8>(d, simd, 0, channels),
                (8, false) => {
                    sweep::<T, S, 4, 3>(d, simd, 0, channels);
                    sweep::<T, S, 4, 3>(d, simd, 4, channels);
                }
                (4, false) => sweep::<T, S, 4, 3>(d, simd, 0, channels),
                (2, false) => sweep::<T, S, 2, 4>(d, simd, 0, channels),
                _ => sweep::<T, S, 1, 6>(d, simd, 0, channels),
            }
        }
    }
}

/// All positions of outputs `first .. first + O`, `V` registers at a time.
#[inline(always)]
fn sweep<T: Scalar, S: Simd, const O: usize, const V: usize>(
    d: &mut Direct<'_, '_, T>,
    simd: S,
    first: usize,
    channels: [usize; 2],
) {
    let lanes = T::lanes::<S>();
    for row in 0..d.rows {
        let mut pos = 0;
        while pos < d.len {
            let left = (d.len - pos).div_ceil(lanes);
            let at = [row * d.pitches[0] + pos, row * d.pitches[1] + pos];
            // Two and two cost less than three and one.
            if left >= V && (V, left) != (3, 4) {
                tile::<T, S, O, V>(d, simd, first, channels, at);
                pos += V * lanes;
            } else if left >= 2 {
                tile::<T, S, O, 2>(d, simd, first, channels, at);
                pos += 2 * lanes;
            } else {
                tile::<T, S, O, 1>(d, simd, first, channels, at);
                pos += lanes;
            }
        }
    }
}

/// `V` registers from place `from` of the input on, to place `to` of the output.
#[inline(always)]
fn tile<T: Scalar, S: Simd, const O: usize, const V: usize>(
    d: &mut Direct<'_, '_, T>,
    simd: S,
    first: usize,
    [begin, end]: [usize; 2],
    [from, to]: [usize; 2],
) {
    let lanes = T::lanes::<S>();
    let mut acc = [[T::splat(simd, T::ZERO); V]; O];
    if begin > 0 || d.add {
        unroll!(K in 0 1 2 3 4 5 6 7 => {
            if K < O {
                let row = &d.out[first + K][to..][..V * lanes];
                unroll!(L in 0 1 2 3 4 5 6 7 => {
                    if L < V {
                        acc[K][L] = T::load::<S>(&row[L * lanes..]);
                    }
                });
            }
        });
    }
    let rows: [&[T]; O] = std::array::from_fn(|o| &d.weights[(first + o) * d.output_stride..]);
    for c in begin..end {
        let x = &d.x[c * d.channel_len + from..];
        let rows: [&[T]; O] = std::array::from_fn(|o| &rows[o][c * d.channel_stride..][..d.kernel]);
        for tap in d.taps {
            let x = &T::registers::<S>(&x[tap.offset..][..V * lanes])[..V];
            unroll!(K in 0 1 2 3 4 5 6 7 => {
                if K < O {
                    let w = T::splat(simd, rows[K][tap.weight]);
                    unroll!(L in 0 1 2 3 4 5 6 7 => {
                        if L < V {
                            acc[K][L] = T::fma(simd, w, x[L], acc[K][L]);
                        }
                    });
                }
            });
        }
    }
    if end == d.channels && !d.bias.is_empty() {
        unroll!(K in 0 1 2 3 4 5 6 7 => {
            if K < O {
                let bias = T::splat(simd, d.bias[first + K]);
                unroll!(L in 0 1 2 3 4 5 6 7 => {
                    if L < V {
                        acc[K][L] = T::plus(simd, acc[K][L], bias);
                    }
                });
            }
        });
    }
    unroll!(K in 0 1 2 3 4 5 6 7 => {
        if K < O {
            let row = &mut d.out[first + K][to..][..V * lanes];
            unroll!(L in 0 1 2 3 4 5 6 7 => {
                if L < V {
                    T::store::<S>(&mut row[L * lanes..], acc[K][L]);
                }
            });
        }
    });
}
