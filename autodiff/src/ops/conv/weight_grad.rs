//! The weight gradient: dot products of output-gradient planes with shifted input planes, over the whole batch.

use pulp::{Arch, Simd, WithSimd};

use crate::Scalar;

/// Output channels of one register block.
pub const OUTPUTS: usize = 4;
/// Pairs of (input channel, tap) of one register block.
pub const PAIRS: usize = 6;
/// Positions after which lanes are flushed to `f64`.
const FLUSH: usize = 4096;

/// Dot products of up to four output channels with all (input channel, tap) pairs of a range of channels.
pub struct WeightGrad<'a, T> {
    /// Output gradients of one group: image `n`, channel `o` starts at `n * g_image + o * pitch`.
    pub g: &'a [T],
    pub g_image: usize,
    pub pitch: usize,
    /// Packed input of one group: image `n` starts at `n * x_image`.
    pub x: &'a [T],
    pub x_image: usize,
    /// Offset of every (input channel, tap) pair within an image.
    pub pairs: &'a [usize],
    pub images: usize,
    /// First output channel and how many (at most [`OUTPUTS`]).
    pub first: usize,
    pub outputs: usize,
}

impl<T: Scalar> WeightGrad<'_, T> {
    /// The sums, `[output][pair]`.
    pub fn run(self) -> Vec<f64> {
        let mut sums = vec![0.0; self.outputs * self.pairs.len()];
        Arch::new().dispatch(Run { task: self, sums: &mut sums });
        sums
    }
}

struct Run<'a, 'b, T> {
    task: WeightGrad<'a, T>,
    sums: &'b mut [f64],
}

impl<T: Scalar> WithSimd for Run<'_, '_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let count = self.task.pairs.len();
        let mut at = 0;
        while at < count {
            let left = count - at;
            let step = if left >= PAIRS {
                PAIRS
            } else if left >= 3 {
                3
            } else {
                1
            };
            match (self.task.outputs, step) {
                (4, 6) => block::<T, S, 4, 6>(&self.task, simd, at, self.sums),
                (4, 3) => block::<T, S, 4, 3>(&self.task, simd, at, self.sums),
                (4, _) => block::<T, S, 4, 1>(&self.task, simd, at, self.sums),
                (outputs, _) => {
                    for o in 0..outputs {
                        let task = WeightGrad { first: self.task.first + o, outputs: 1, ..self.task };
                        let sums = &mut self.sums[o * count..(o + 1) * count];
                        match step {
                            6 => block::<T, S, 1, 6>(&task, simd, at, sums),
                            3 => block::<T, S, 1, 3>(&task, simd, at, sums),
                            _ => block::<T, S, 1, 1>(&task, simd, at, sums),
                        }
                    }
                }
            }
            at += step;
        }
    }
}

#[inline(always)]
fn block<T: Scalar, S: Simd, const O: usize, const P: usize>(t: &WeightGrad<'_, T>, simd: S, at: usize, sums: &mut [f64]) {
    let lanes = T::lanes::<S>();
    let zero = T::splat(simd, T::ZERO);
    let mut acc = [[zero; P]; O];
    let mut held = 0;
    for n in 0..t.images {
        let g = &t.g[n * t.g_image + t.first * t.pitch..][..O * t.pitch];
        let x = &t.x[n * t.x_image..];
        let mut pos = 0;
        while pos < t.pitch {
            let end = (pos + FLUSH).min(t.pitch);
            while pos < end {
                let mut gs = [zero; O];
                for o in 0..O {
                    gs[o] = T::load::<S>(&g[o * t.pitch + pos..]);
                }
                for p in 0..P {
                    let x = T::load::<S>(&x[t.pairs[at + p] + pos..]);
                    for o in 0..O {
                        acc[o][p] = T::fma(simd, gs[o], x, acc[o][p]);
                    }
                }
                pos += lanes;
                held += lanes;
            }
            if held >= FLUSH {
                flush::<T, S, O, P>(simd, &mut acc, t.pairs.len(), at, sums);
                held = 0;
            }
        }
    }
    flush::<T, S, O, P>(simd, &mut acc, t.pairs.len(), at, sums);
}

#[inline(always)]
fn flush<T: Scalar, S: Simd, const O: usize, const P: usize>(
    simd: S,
    acc: &mut [[T::Reg<S>; P]; O],
    count: usize,
    at: usize,
    sums: &mut [f64],
) {
    for o in 0..O {
        for p in 0..P {
            sums[o * count + at + p] += T::reduce_sum(simd, acc[o][p]).to_f64();
            acc[o][p] = T::splat(simd, T::ZERO);
        }
    }
}
