//! The products of Winograd's schemes on one thread: for every sum, matrix products of transformed weights and inputs.

use pulp::{Arch, Simd, WithSimd};

use super::winograd_kernels::STRIP;
use super::winograd_schemes::{Kind, Scheme, WEIGHTS};
use crate::Scalar;
use crate::simd::unroll;

/// Output channels of a register block.
pub const BLOCK: usize = 8;
/// Products after which partial sums are put down, so that what is read again and again stays in the nearest cache.
pub const SUMMED: usize = 128;

/// Sums over the input channels: for each sum of the scheme, a block of outputs times all tiles.
pub struct Products<'a, T> {
    pub kind: Kind,
    /// As [`Weights`](super::winograd_kernels::Weights) leaves them, planes `weights_step` apart.
    pub weights: &'a [T],
    pub weights_step: usize,
    /// Plane `p` starts at `p * step`, its channels are `pitch` apart.
    pub inputs: &'a [T],
    pub step: usize,
    pub pitch: usize,
    pub channels: usize,
    /// Tiles.
    pub len: usize,
    /// Outputs, a multiple of [`BLOCK`].
    pub outputs: usize,
    /// `[sum][output][pitch]`.
    pub out: &'a mut [T],
    /// Whether to add to `out` rather than to fill it.
    pub add: bool,
}

impl<T: Scalar> WithSimd for Products<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let lanes = T::lanes::<S>();
        // 32 registers with the widest ones, else 16.
        let many = lanes * size_of::<T>() == 64;
        let p = &mut self;
        let Scheme { sums, inputs, .. } = p.kind.scheme();
        let together = (SUMMED / p.channels).max(1);
        for (i, rows) in sums.iter().enumerate() {
            for (j, columns) in sums.iter().enumerate() {
                let (mut terms, mut count) = ([Term::default(); TERMS], 0);
                for row in *rows {
                    for column in *columns {
                        let weights = (row.0 * WEIGHTS + column.0) * p.weights_step;
                        terms[count] = Term { weights, inputs: (row.1 * inputs + column.1) * p.step };
                        count += 1;
                    }
                }
                let out = (i * sums.len() + j) * p.outputs * p.pitch;
                let mut at = 0;
                while at < p.len {
                    let left = (p.len - at).div_ceil(lanes);
                    // Two and two cost less than three and one.
                    let registers = if left == 4 { 2 } else { left.min(3) };
                    for (i, terms) in terms[..count].chunks(together).enumerate() {
                        for o in (0..p.outputs).step_by(BLOCK) {
                            let place = Place { output: o, tile: at, out: out + o * p.pitch + at, add: p.add || i > 0 };
                            match (registers, many) {
                                (3, true) => block::<T, S, 8, 3>(p, simd, terms, place),
                                (2, true) => block::<T, S, 8, 2>(p, simd, terms, place),
                                (3, false) => {
                                    block::<T, S, 4, 3>(p, simd, terms, place);
                                    block::<T, S, 4, 3>(p, simd, terms, place.below(4, p.pitch));
                                }
                                (2, false) => {
                                    block::<T, S, 4, 2>(p, simd, terms, place);
                                    block::<T, S, 4, 2>(p, simd, terms, place.below(4, p.pitch));
                                }
                                _ => block::<T, S, 8, 1>(p, simd, terms, place),
                            }
                        }
                    }
                    at += registers * lanes;
                }
            }
        }
    }
}

/// Most products of a sum.
const TERMS: usize = 4;

/// Where the planes of a product start.
#[derive(Clone, Copy, Default)]
struct Term {
    weights: usize,
    inputs: usize,
}

/// Where a block of products starts.
#[derive(Clone, Copy)]
struct Place {
    output: usize,
    tile: usize,
    out: usize,
    /// Whether to add to `out` rather than to fill it.
    add: bool,
}

impl Place {
    /// The same for later outputs.
    #[inline(always)]
    fn below(self, outputs: usize, pitch: usize) -> Self {
        Place { output: self.output + outputs, out: self.out + outputs * pitch, ..self }
    }
}

/// `O` outputs times `V` registers of tiles.
#[inline(always)]
fn block<T: Scalar, S: Simd, const O: usize, const V: usize>(p: &mut Products<'_, T>, simd: S, terms: &[Term], place: Place) {
    let lanes = T::lanes::<S>();
    let out = &mut p.out[place.out..];
    let mut acc = [[T::splat(simd, T::ZERO); V]; O];
    if place.add {
        unroll!(K in 0 1 2 3 4 5 6 7 => {
            if K < O {
                unroll!(L in 0 1 2 => {
                    if L < V {
                        acc[K][L] = T::load::<S>(&out[K * p.pitch + L * lanes..]);
                    }
                });
            }
        });
    }
    let strip = place.output / STRIP * STRIP * p.channels + place.output % STRIP;
    for term in terms {
        let inputs = p.inputs[term.inputs + place.tile..].chunks(p.pitch);
        let weights = p.weights[term.weights + strip..].chunks(STRIP);
        for (x, w) in inputs.zip(weights).take(p.channels) {
            let x = &T::registers::<S>(&x[..V * lanes])[..V];
            let w = &w[..O];
            unroll!(K in 0 1 2 3 4 5 6 7 => {
                if K < O {
                    let w = T::splat(simd, w[K]);
                    unroll!(L in 0 1 2 => {
                        if L < V {
                            acc[K][L] = T::fma(simd, w, x[L], acc[K][L]);
                        }
                    });
                }
            });
        }
    }
    unroll!(K in 0 1 2 3 4 5 6 7 => {
        if K < O {
            unroll!(L in 0 1 2 => {
                if L < V {
                    T::store::<S>(&mut out[K * p.pitch + L * lanes..], acc[K][L]);
                }
            });
        }
    });
}

impl<T: Scalar> Products<'_, T> {
    /// Runs the kernel on the processor's widest registers.
    pub fn run(self) {
        Arch::new().dispatch(self);
    }
}
