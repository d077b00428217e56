//! The direct product: output blocks as sums of shifted input planes times broadcast weights, in registers.

use pulp::{Arch, Simd, WithSimd};

use crate::{Pool, Scalar};

/// Output channels of a full block.
pub const BLOCK: usize = 8;

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

/// Weights in the order in which the kernel reads them: `[block][input channel][tap][lane of the block]`.
///
/// `at(output, input, tap)` is the index of a weight. The weights of a block begin at `block.start * inputs * taps`.
pub fn pack_weights<T: Scalar>(
    w: &[T],
    [outputs, inputs, taps]: [usize; 3],
    at: impl Fn(usize, usize, usize) -> usize,
    pool: &Pool<T>,
) -> Vec<T> {
    let mut packed = pool.take(outputs * inputs * taps);
    for OutputBlock { start, width } in blocks(outputs) {
        let part = &mut packed[start * inputs * taps..][..width * inputs * taps];
        for (k, lanes) in part.chunks_exact_mut(width).enumerate() {
            for (lane, p) in lanes.iter_mut().enumerate() {
                *p = w[at(start + lane, k / taps, k % taps)];
            }
        }
    }
    packed
}

/// One block of outputs at flat positions `0..len`: `out[lane][pos] = sum over channels and taps of w * x`.
pub struct Direct<'a, T> {
    /// Input planes; channel `c` starts at `c * channel_len`.
    pub x: &'a [T],
    pub channel_len: usize,
    /// Packed weights of the block.
    pub weights: &'a [T],
    /// Offset of every tap within a channel.
    pub offsets: &'a [usize],
    /// Flat positions wanted.
    pub len: usize,
    /// Output rows of `pitch` elements, one for each channel of the block; `pitch` is `padded_len(len)`.
    pub out: &'a mut [T],
    /// Channels of the block: 8, 4, 2 or 1.
    pub width: usize,
}

/// `len` rounded up so that whole registers can be stored.
pub fn padded_len(len: usize) -> usize {
    len.div_ceil(16) * 16
}

impl<T: Scalar> Direct<'_, T> {
    /// Runs the kernel on the processor's widest registers.
    pub fn run(self) {
        Arch::new().dispatch(self);
    }
}

impl<T: Scalar> WithSimd for Direct<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        match self.width {
            8 => sweep::<T, S, 8>(&mut self, simd),
            4 => sweep::<T, S, 4>(&mut self, simd),
            2 => sweep::<T, S, 2>(&mut self, simd),
            _ => sweep::<T, S, 1>(&mut self, simd),
        }
    }
}

#[inline(always)]
fn sweep<T: Scalar, S: Simd, const O: usize>(d: &mut Direct<'_, T>, simd: S) {
    let lanes = T::lanes::<S>();
    let mut pos = 0;
    while pos < d.len {
        match (d.len - pos).div_ceil(lanes) {
            1 => tile::<T, S, O, 1>(d, simd, pos),
            2 => tile::<T, S, O, 2>(d, simd, pos),
            _ => tile::<T, S, O, 3>(d, simd, pos),
        }
        pos += 3 * lanes;
    }
}

#[inline(always)]
fn tile<T: Scalar, S: Simd, const O: usize, const V: usize>(d: &mut Direct<'_, T>, simd: S, pos: usize) {
    let lanes = T::lanes::<S>();
    let mut acc = [[T::splat(simd, T::ZERO); V]; O];
    for (c, weights) in d.weights.chunks_exact(O * d.offsets.len()).enumerate() {
        let channel = &d.x[c * d.channel_len + pos..];
        for (&offset, w) in d.offsets.iter().zip(weights.chunks_exact(O)) {
            let x = &channel[offset..offset + V * lanes];
            let mut xs = [T::splat(simd, T::ZERO); V];
            for (v, r) in xs.iter_mut().enumerate() {
                *r = T::load::<S>(&x[v * lanes..]);
            }
            for (acc, &w) in acc.iter_mut().zip(w) {
                let w = T::splat(simd, w);
                for (acc, &x) in acc.iter_mut().zip(&xs) {
                    *acc = T::fma(simd, w, x, *acc);
                }
            }
        }
    }
    let pitch = d.out.len() / O;
    for (row, acc) in d.out.chunks_exact_mut(pitch).zip(acc) {
        for (v, r) in acc.into_iter().enumerate() {
            T::store::<S>(&mut row[pos + v * lanes..], r);
        }
    }
}
