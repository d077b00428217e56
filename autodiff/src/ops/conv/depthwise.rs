//! Convolutions that mix no channels, stride 1. A unit of work is one plane: it is padded into a scratch that stays in the nearest
//! cache, and read there once for every tap.

use std::sync::Arc;

use pulp::{Arch, Simd, WithSimd};

use super::after::After;
use super::backward_input::store_dense;
use super::layout::{Layout, SLACK};
use crate::simd::{Wide, unroll};
use crate::{PadMode, Pool, Scalar, par};

/// Registers of outputs that are summed at one time.
const BLOCK: usize = 4;

/// `y = w * x + b`.
pub fn forward<T: Scalar>(l: &Layout, x: &[T], w: &[T], after: After<'_, T>, pool: &Arc<Pool<T>>) -> Vec<T> {
    let mut y = pool.take(l.output.len());
    let offsets = l.tap_offsets();
    let (channels, plane) = (l.groups, l.input.plane());
    par::for_each_chunk(&mut y, l.output.plane(), |i, out| {
        let c = i % channels;
        let mut padded = pool.take(l.channel_len() + SLACK);
        l.pack_plane(&x[i * plane..][..plane], &mut padded[..l.channel_len()]);
        T::run_rows(Rows {
            x: &padded,
            pitch: l.phase_w,
            offsets: &offsets,
            weights: &w[c * l.taps..][..l.taps],
            start: after.bias(c),
            out,
            width: l.output.w(),
        });
        after.activate(out);
        pool.give(padded);
    });
    y
}

/// Fills `dx`, whatever it held.
pub fn backward_input<T: Scalar>(l: &Layout, g: &[T], w: &[T], dx: &mut [T], pool: &Arc<Pool<T>>) {
    let (channels, plane) = (l.groups, l.output.plane());
    let (up, left) = l.reach();
    let (pitch, height) = (l.phase_w + left, l.phase_h + up);
    let offsets: Vec<usize> = l.tap_at.iter().map(|&(_, y, x)| (up - y) * pitch + (left - x)).collect();
    par::for_each_chunk(dx, l.input.plane(), |i, dx| {
        let mut bordered = pool.take(height * pitch + SLACK);
        bordered.fill(T::ZERO);
        for (row, g) in bordered.chunks_exact_mut(pitch).skip(up).zip(g[i * plane..][..plane].chunks_exact(l.output.w())) {
            row[left..][..g.len()].copy_from_slice(g);
        }
        let weights = &w[i % channels * l.taps..][..l.taps];
        let rows = |x, out, width| Rows { x, pitch, offsets: &offsets, weights, start: T::ZERO, out, width };
        if l.pad_mode == PadMode::Zero {
            // No reader wants what falls outside the image.
            let (above, before) = l.padding();
            T::run_rows(rows(&bordered[above * pitch + before..], dx, l.input.w()));
        } else {
            let mut padded = pool.take(l.phase_len());
            T::run_rows(rows(&bordered, &mut padded, l.phase_w));
            store_dense(l, padded.chunks_exact(l.phase_w).zip(0..l.phase_h), 0, dx);
            pool.give(padded);
        }
        pool.give(bordered);
    });
}

/// Adds the gradient of the weights.
pub fn backward_weight<T: Scalar>(l: &Layout, x: &[T], g: &[T], dw: &mut [T], pool: &Arc<Pool<T>>) {
    let offsets = l.tap_offsets();
    let (channels, plane, out_plane) = (l.groups, l.input.plane(), l.output.plane());
    par::for_each_chunk(dw, l.taps, |c, dw| {
        let mut padded = pool.take(l.channel_len() + SLACK);
        let mut sums = vec![0.0; l.taps];
        for n in 0..l.input.n() {
            let i = n * channels + c;
            l.pack_plane(&x[i * plane..][..plane], &mut padded[..l.channel_len()]);
            let g = &g[i * out_plane..][..out_plane];
            T::run_products(Products {
                x: &padded,
                pitch: l.phase_w,
                offsets: &offsets,
                g,
                width: l.output.w(),
                sums: &mut sums,
            });
        }
        for (d, s) in dw.iter_mut().zip(sums) {
            *d += T::from_f64(s);
        }
        pool.give(padded);
    });
}

/// Every row of `out` as a sum of shifted rows of `x` times one weight each.
pub struct Rows<'a, T> {
    /// Rows `pitch` apart, readable a register beyond the last one.
    pub x: &'a [T],
    pub pitch: usize,
    /// Where each tap reads, from the output's position.
    pub offsets: &'a [usize],
    pub weights: &'a [T],
    /// What the sums begin with.
    pub start: T,
    /// Rows of `width`, one after the other.
    pub out: &'a mut [T],
    pub width: usize,
}

impl<T: Scalar> Rows<'_, T> {
    /// Runs the kernel on the processor's widest registers.
    pub fn run(self) {
        Arch::new().dispatch(self);
    }
}

impl<T: Scalar> WithSimd for Rows<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let lanes = T::lanes::<S>();
        let Rows { x, pitch, offsets, weights, start, out, width } = self;
        for (row, out) in out.chunks_exact_mut(width).enumerate() {
            let x = &x[row * pitch..];
            let mut pos = 0;
            while pos + BLOCK * lanes <= width {
                let sums = sums_of::<T, S, BLOCK>(simd, &x[pos..], offsets, weights, start);
                unroll!(K in 0 1 2 3 => { sums[K].store(&mut out[pos + K * lanes..]); });
                pos += BLOCK * lanes;
            }
            while pos < width {
                let [sum] = sums_of::<T, S, 1>(simd, &x[pos..], offsets, weights, start);
                match width - pos {
                    left if left < lanes => sum.store_part(&mut out[pos..]),
                    _ => sum.store(&mut out[pos..]),
                }
                pos += lanes;
            }
        }
    }
}

#[inline(always)]
fn sums_of<T: Scalar, S: Simd, const V: usize>(simd: S, x: &[T], offsets: &[usize], weights: &[T], start: T) -> [Wide<S, T>; V] {
    let lanes = T::lanes::<S>();
    let mut sums = [Wide::splat(simd, start); V];
    for (&offset, &w) in offsets.iter().zip(weights) {
        let w = Wide::splat(simd, w);
        let x = &x[offset..][..V * lanes];
        unroll!(K in 0 1 2 3 => {
            if K < V {
                sums[K] = w.mul_add(Wide::load(simd, &x[K * lanes..]), sums[K]);
            }
        });
    }
    sums
}

/// Sums over all positions of `g` times what each tap reads of `x`.
pub struct Products<'a, T> {
    /// Rows `pitch` apart, readable a register beyond the last one; finite also where no tap reads.
    pub x: &'a [T],
    pub pitch: usize,
    /// Where each tap reads, from the output's position.
    pub offsets: &'a [usize],
    /// Rows of `width`, one after the other.
    pub g: &'a [T],
    pub width: usize,
    /// One for each tap, to be added to.
    pub sums: &'a mut [f64],
}

impl<T: Scalar> Products<'_, T> {
    /// Runs the kernel on the processor's widest registers.
    pub fn run(self) {
        Arch::new().dispatch(self);
    }
}

impl<T: Scalar> WithSimd for Products<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Products { x, pitch, offsets, g, width, sums } = self;
        // Rows after which the lanes go to f64.
        let rows = 2048usize.div_ceil(width) * width;
        for (tile, g) in g.chunks(rows).enumerate() {
            let x = &x[tile * (rows / width) * pitch..];
            let mut taps = offsets.chunks_exact(3).zip(sums.chunks_exact_mut(3));
            for (offsets, sums) in &mut taps {
                products::<T, S, 3>(simd, x, pitch, offsets, g, width, sums);
            }
            let rest = offsets.len() / 3 * 3;
            for (offset, sum) in offsets[rest..].iter().zip(&mut sums[rest..]) {
                products::<T, S, 1>(simd, x, pitch, &[*offset], g, width, std::slice::from_mut(sum));
            }
        }
    }
}

#[inline(always)]
fn products<T: Scalar, S: Simd, const P: usize>(
    simd: S,
    x: &[T],
    pitch: usize,
    offsets: &[usize],
    g: &[T],
    width: usize,
    sums: &mut [f64],
) {
    let lanes = T::lanes::<S>();
    // Two registers a tap: one alone waits for its own last sum.
    let mut even = [Wide::splat(simd, T::ZERO); P];
    let mut odd = even;
    for (row, g) in g.chunks_exact(width).enumerate() {
        let x = &x[row * pitch..];
        let mut pos = 0;
        while pos + 2 * lanes <= width {
            let (a, b) = (Wide::load(simd, &g[pos..]), Wide::load(simd, &g[pos + lanes..]));
            unroll!(K in 0 1 2 => {
                if K < P {
                    let x = &x[pos + offsets[K]..][..2 * lanes];
                    even[K] = a.mul_add(Wide::load(simd, x), even[K]);
                    odd[K] = b.mul_add(Wide::load(simd, &x[lanes..]), odd[K]);
                }
            });
            pos += 2 * lanes;
        }
        while pos < width {
            let part = lanes.min(width - pos);
            let g = if part < lanes { Wide::load_part(simd, &g[pos..]) } else { Wide::load(simd, &g[pos..]) };
            unroll!(K in 0 1 2 => {
                if K < P {
                    let x = &x[pos + offsets[K]..];
                    let x = if part < lanes { Wide::load_part(simd, &x[..part]) } else { Wide::load(simd, x) };
                    even[K] = g.mul_add(x, even[K]);
                }
            });
            pos += lanes;
        }
    }
    unroll!(K in 0 1 2 => {
        if K < P {
            sums[K] += (even[K] + odd[K]).sum().to_f64();
        }
    });
}
