//! The gradient of the weights: which kernel for which shape, and its units of work.

use std::sync::Arc;

use super::direct::padded_len;
use super::layout::Layout;
use super::weight_grad::{OUTPUTS, WeightGrad};
use super::weight_outer::{STRIP, WeightOuter};
use crate::{Pool, Scalar, par};

/// Output channels from which on strips of them are worth their copy.
const FEW_OUTPUTS: usize = 4;

/// Adds the gradient of the weights.
pub fn backward_weight<T: Scalar>(l: &Layout, x: &[T], g: &[T], dw: &mut [T], pool: &Arc<Pool<T>>) {
    let packed = l.pack_input(x, pool);
    if l.cout > FEW_OUTPUTS {
        for group in 0..l.groups {
            weight_by_strips(l, &packed, g, group, dw, pool);
        }
    } else {
        weight_by_planes(l, &packed, g, dw, pool);
    }
    pool.give(packed);
}

/// Many output channels: a unit of work owns a strip of them and a run of (input channel, tap) pairs.
fn weight_by_strips<T: Scalar>(l: &Layout, packed: &[T], g: &[T], group: usize, dw: &mut [T], pool: &Arc<Pool<T>>) {
    /// Products of a unit, about.
    const WORK: usize = 1 << 20;
    let strips = l.pack_strips(g, group, pool);
    let positions = l.output.n() * l.output.plane();
    let offsets = l.tap_offsets();
    let pairs: Vec<usize> = (0..l.cin).flat_map(|c| offsets.iter().map(move |t| c * l.channel_len() + t)).collect();
    let run = (WORK / (positions * STRIP)).max(1).next_multiple_of(12).min(pairs.len());
    let runs = pairs.len().div_ceil(run);
    let sums = par::map_indices(l.cout.div_ceil(STRIP) * runs, |unit| {
        T::run_weight_outer(WeightOuter {
            g: &strips[unit / runs * positions * STRIP..][..positions * STRIP],
            x: &packed[group * l.cin * l.channel_len()..],
            x_image: l.input.c() * l.channel_len(),
            x_row: l.phase_w,
            pairs: &pairs[unit % runs * run..pairs.len().min((unit % runs + 1) * run)],
            size: [l.output.n(), l.output.h(), l.output.w()],
        })
    });
    let per_output = l.cin * l.taps;
    for (unit, sums) in sums.iter().enumerate() {
        let (first, from) = (unit / runs * STRIP, unit % runs * run);
        for (k, sums) in sums.chunks_exact(STRIP).enumerate() {
            for (o, &s) in sums[..STRIP.min(l.cout - first)].iter().enumerate() {
                dw[(group * l.cout + first + o) * per_output + from + k] += T::from_f64(s);
            }
        }
    }
    pool.give(strips);
}

/// Few output channels: a unit of work owns four of them and up to 16 input channels.
fn weight_by_planes<T: Scalar>(l: &Layout, packed: &[T], g: &[T], dw: &mut [T], pool: &Arc<Pool<T>>) {
    const CHANNELS: usize = 16;
    let pitch = padded_len(l.flat_len());
    let flat = l.pack_flat_grad(g, pitch, pool);
    let offsets = l.tap_offsets();
    let output_blocks = l.cout.div_ceil(OUTPUTS);
    let channel_blocks = l.cin.div_ceil(CHANNELS);
    let per_group = output_blocks * channel_blocks;
    let span = |unit: usize| {
        let (group, unit) = (unit / per_group, unit % per_group);
        let (o, c) = (unit / channel_blocks * OUTPUTS, unit % channel_blocks * CHANNELS);
        (group, o, c, OUTPUTS.min(l.cout - o), CHANNELS.min(l.cin - c))
    };
    let sums = par::map_indices(l.groups * per_group, |unit| {
        let (group, o, c, outputs, channels) = span(unit);
        let pairs: Vec<usize> = (c..c + channels).flat_map(|c| offsets.iter().map(move |t| c * l.channel_len() + t)).collect();
        T::run_weight_grad(WeightGrad {
            g: &flat[group * l.cout * pitch..],
            g_image: l.output.c() * pitch,
            pitch,
            x: &packed[group * l.cin * l.channel_len()..],
            x_image: l.input.c() * l.channel_len(),
            pairs: &pairs,
            images: l.input.n(),
            first: o,
            outputs,
        })
    });
    for (unit, sums) in sums.iter().enumerate() {
        let (group, o, c, _, channels) = span(unit);
        let run = channels * l.taps;
        for (i, sums) in sums.chunks_exact(run).enumerate() {
            let at = ((group * l.cout + o + i) * l.cin + c) * l.taps;
            for (d, &s) in dw[at..at + run].iter_mut().zip(sums) {
                *d += T::from_f64(s);
            }
        }
    }
    pool.give(flat);
}
