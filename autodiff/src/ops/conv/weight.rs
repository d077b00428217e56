//! The gradient of the weights: which kernel for which shape, and its units of work.

use std::sync::Arc;

use super::direct::padded_len;
use super::layout::Layout;
use super::weight_grad::{OUTPUTS, WeightGrad};
use super::weight_outer::{STRIP, WeightOuter};
use crate::{Pool, Scalar, par};

/// Products of a unit, about.
const WORK: usize = 1 << 22;
/// Units that are enough for every thread to have some.
const UNITS: usize = 16;
/// Output channels up to which strips of them are not worth their copy.
const FEW_OUTPUTS: usize = 8;

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

/// Many output channels: a unit of work owns a strip of them and a run of (input channel, tap) pairs, or a part of the rows
/// where there would be too few units.
fn weight_by_strips<T: Scalar>(l: &Layout, packed: &[T], g: &[T], group: usize, dw: &mut [T], pool: &Arc<Pool<T>>) {
    let g = l.pack_strips(g, group, pool);
    let offsets = l.tap_offsets();
    // With one register of outputs, every product loads its input: three taps side by side share one place to read from.
    let together = if l.cout <= STRIP / 2 && l.taps_in_threes() { 3 } else { 1 };
    let starts: Vec<usize> = offsets.into_iter().step_by(together).collect();
    let starts: Vec<usize> = (0..l.cin).flat_map(|c| starts.iter().map(move |t| c * l.channel_len() + t)).collect();
    let pairs = starts.len() * together;
    let lines = l.output.n() * l.output.h();
    let positions = lines * l.output.w();
    let run = (WORK / (positions * STRIP)).next_multiple_of(if together == 3 { 24 } else { 10 });
    let run = run.clamp(if together == 3 { 48 } else { 50 }, 240).min(pairs);
    let owned = runs(&mut dw[group * l.cout * pairs..][..l.cout * pairs], pairs, run, &l.strips());
    let parts = (UNITS / owned.len()).clamp(1, lines).min(positions.div_ceil(2048));
    par::for_each_item(owned, |_, mut owned| {
        let width = owned.width;
        let count = owned.rows[0].len();
        let sums = par::map_indices(parts, |part| {
            let mut sums = vec![0.0; count * width];
            T::run_weight_outer(WeightOuter {
                g: &g[owned.first * positions..],
                width,
                x: &packed[group * l.cin * l.channel_len()..],
                x_image: l.input.c() * l.channel_len(),
                x_row: l.phase_w,
                runs: &starts[owned.from / together..][..count / together],
                taps: together,
                size: [l.output.n(), l.output.h(), l.output.w()],
                lines: lines * part / parts..lines * (part + 1) / parts,
                sums: &mut sums,
            });
            sums
        });
        let mut parts = sums.into_iter();
        let mut sums = parts.next().expect("there is a part at least");
        for part in parts {
            sums.iter_mut().zip(part).for_each(|(sum, part)| *sum += part);
        }
        // Some weights of every output at a time, a cache line of each.
        for (from, sums) in (0..count).step_by(16).zip(sums.chunks(16 * width)) {
            for (o, row) in owned.rows.iter_mut().enumerate() {
                for (d, sums) in row[from..].iter_mut().zip(sums.chunks_exact(width)) {
                    *d += T::from_f64(sums[o]);
                }
            }
        }
    });
    pool.give(g);
}

/// Weights of a strip of outputs and of a run of pairs.
struct Run<'a, T> {
    /// First output and width of the strip.
    first: usize,
    width: usize,
    /// First pair.
    from: usize,
    /// Those of every output.
    rows: Vec<&'a mut [T]>,
}

fn runs<'a, T>(dw: &'a mut [T], pairs: usize, run: usize, strips: &[(usize, usize)]) -> Vec<Run<'a, T>> {
    let mut out = Vec::new();
    let mut rows: Vec<_> = dw.chunks_exact_mut(pairs).map(|row| row.chunks_mut(run)).collect();
    for (rows, &(first, width)) in rows.chunks_mut(STRIP).zip(strips) {
        for from in (0..pairs).step_by(run) {
            let rows = rows.iter_mut().map(|row| row.next().expect("every row has all runs")).collect();
            out.push(Run { first, width, from, rows });
        }
    }
    out
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
