//! The weight gradient: dot products of output-gradient planes with shifted input planes, over the whole batch.

use pulp::{Arch, Simd, WithSimd};

use crate::Scalar;
use crate::simd::unroll;

/// Output channels of one register block.
pub const OUTPUTS: usize = 4;
/// Pairs of (input channel, tap) of one register block.
pub const PAIRS: usize = 5;
/// Positions after which lanes are flushed to `f64`.
const FLUSH: usize = 1024;

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
        for n in 0..self.task.images {
            // All pairs visit a few positions before the next ones are read.
            for pos in (0..self.task.pitch).step_by(FLUSH) {
                let mut at = 0;
                while at < count {
                    at += match (self.task.outputs, count - at) {
                        (4, PAIRS..) => block::<T, S, 4, PAIRS>(&self.task, simd, [n, pos, 0], at, self.sums),
                        (4, 3..) => block::<T, S, 4, 3>(&self.task, simd, [n, pos, 0], at, self.sums),
                        (4, _) => block::<T, S, 4, 1>(&self.task, simd, [n, pos, 0], at, self.sums),
                        (outputs, left) => {
                            for o in 0..outputs {
                                match left {
                                    PAIRS.. => block::<T, S, 1, PAIRS>(&self.task, simd, [n, pos, o], at, self.sums),
                                    3.. => block::<T, S, 1, 3>(&self.task, simd, [n, pos, o], at, self.sums),
                                    _ => block::<T, S, 1, 1>(&self.task, simd, [n, pos, o], at, self.sums),
                                };
                            }
                            match left {
                                PAIRS.. => PAIRS,
                                3.. => 3,
                                _ => 1,
                            }
                        }
                    };
                }
            }
        }
    }
}

/// Adds to the sums of `O` outputs from `first` on and `P` pairs from `at` on what the positions from `pos` on of image `n` give.
/// Returns `P`.
#[inline(always)]
fn block<T: Scalar, S: Simd, const O: usize, const P: usize>(
    t: &WeightGrad<'_, T>,
    simd: S,
    [n, pos, first]: [usize; 3],
    at: usize,
    sums: &mut [f64],
) -> usize {
    let lanes = T::lanes::<S>();
    let pairs = t.pairs.len();
    let g = &t.g[n * t.g_image + (t.first + first) * t.pitch..][..O * t.pitch];
    let x = &t.x[n * t.x_image..];
    let len = FLUSH.min(t.pitch - pos);
    let steps = len / lanes;
    let gs: [&[T::Reg<S>]; O] = std::array::from_fn(|o| &T::registers::<S>(&g[o * t.pitch + pos..][..len])[..steps]);
    let xs: [&[T::Reg<S>]; P] = std::array::from_fn(|p| &T::registers::<S>(&x[t.pairs[at + p] + pos..][..len])[..steps]);
    let mut acc = [[T::splat(simd, T::ZERO); P]; O];
    for i in 0..steps {
        let x: [_; P] = std::array::from_fn(|p| xs[p][i]);
        unroll!(K in 0 1 2 3 => {
            if K < O {
                let g = gs[K][i];
                unroll!(L in 0 1 2 3 4 => {
                    if L < P {
                        acc[K][L] = T::fma(simd, g, x[L], acc[K][L]);
                    }
                });
            }
        });
    }
    unroll!(K in 0 1 2 3 => {
        if K < O {
            unroll!(L in 0 1 2 3 4 => {
                if L < P {
                    sums[(first + K) * pairs + at + L] += T::reduce_sum(simd, acc[K][L]).to_f64();
                }
            });
        }
    });
    P
}
