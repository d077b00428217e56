//! The gradient of the input by the direct product: for every phase of the padded input, a stride-1 product of the bordered output
//! gradient with the taps of that phase. A unit of work is a tile of rows of one image and a block of input channels.

use std::ops::Range;
use std::sync::Arc;

use super::direct::{BLOCK, Direct, Tap, blocks, padded_len, split};
use super::forward::tile_rows;
use super::layout::Layout;
use crate::{PadMode, Pool, Scalar, par};

/// Fills `dx`, whatever it held.
pub fn backward_input<T: Scalar>(l: &Layout, g: &[T], w: &[T], dx: &mut [T], pool: &Arc<Pool<T>>) {
    let (bordered, pitch, plane_len) = l.pack_bordered_grad(g, pool);
    let (up, left) = l.reach();
    let phases: Vec<Vec<Tap>> = (0..l.phases.len())
        .map(|phase| {
            let taps = l.tap_at.iter().enumerate().filter(|(_, tap)| tap.0 == phase);
            taps.map(|(weight, &(_, y, x))| Tap { offset: (up - y) * pitch + (left - x), weight }).collect()
        })
        .collect();
    let output_stride = l.taps;
    // Whole registers of rows without a mirrored border need no place of their own.
    let in_place = l.is_dense() && l.pad_mode == PadMode::Zero && padded_len(l.input.w()) == l.input.w();
    par::for_each_item(units(l, dx, tile_rows(pitch, l.cout)), |_, mut unit| {
        let Range { start, end } = unit.phase_rows.clone();
        let direct = |taps| Direct {
            x: &bordered[(unit.image * l.groups + unit.group) * l.cout * plane_len + start * pitch..],
            channel_len: plane_len,
            channels: l.cout,
            weights: &w[(unit.group * l.cout * l.cin + unit.start) * l.taps..],
            output_stride,
            channel_stride: l.cin * l.taps,
            taps,
            kernel: l.taps,
            rows: 1,
            len: (end - start - 1) * pitch + l.phase_w,
            pitches: [0, 0],
            out: &mut [],
            bias: &[],
            add: false,
        };
        if in_place {
            let (width, before) = (l.input.w(), l.padding().1);
            let (direct, out) = (direct(&phases[0]), &mut unit.out[..unit.width]);
            let x = &direct.x[before..];
            T::run_direct(Direct { x, rows: end - start, len: width, pitches: [pitch, width], out, ..direct });
            return;
        }
        let row_pitch = padded_len((end - start - 1) * pitch + l.phase_w);
        let mut scratch = pool.take(unit.width * row_pitch);
        if !l.is_dense() {
            unit.out.iter_mut().for_each(|out| out.fill(T::ZERO));
        }
        for (phase, taps) in phases.iter().enumerate() {
            T::run_direct(Direct { out: &mut split(&mut scratch, unit.width)[..unit.width], ..direct(taps) });
            for (out, flat) in unit.out.iter_mut().zip(scratch.chunks_exact(row_pitch)) {
                let rows = flat.chunks(pitch).zip(start..end);
                if l.is_dense() {
                    store_dense(l, rows, unit.first_row, out);
                } else {
                    add_phase(l, phase, rows, unit.first_row, out);
                }
            }
        }
        pool.give(scratch);
    });
    pool.give(bordered);
}

/// Adds the gradients of a phase of the padded input to the input positions that the padding read. The first phase fills `dx`.
pub fn fold_phase<T: Scalar>(l: &Layout, phase: usize, gradients: &[T], dx: &mut [T]) {
    par::for_each_chunk(dx, l.input.plane(), |i, dx| {
        let rows = gradients[i * l.phase_len()..][..l.phase_len()].chunks_exact(l.phase_w).zip(0..l.phase_h);
        if l.is_dense() {
            store_dense(l, rows, 0, dx);
            return;
        }
        if phase == 0 {
            dx.fill(T::ZERO);
        }
        add_phase(l, phase, rows, 0, dx);
    });
}

/// Writes rows of the padded gradient to the input positions that the padding read, each for the first time from the image itself.
pub fn store_dense<'a, T: Scalar>(
    l: &Layout,
    rows: impl Iterator<Item = (&'a [T], usize)> + Clone,
    first_row: usize,
    out: &mut [T],
) {
    let width = l.input.w();
    let (above, pad) = l.padding();
    let inside = |y: usize| (above..above + l.input.h()).contains(&y);
    for outside in [false, true] {
        for (flat, y) in rows.clone().filter(|&(_, y)| inside(y) != outside) {
            let Some(row) = l.rows.get(y).copied().flatten() else { continue };
            let out = &mut out[(row - first_row) * width..][..width];
            if outside {
                out.iter_mut().zip(&flat[pad..]).for_each(|(d, &f)| *d += f);
            } else {
                out.copy_from_slice(&flat[pad..][..width]);
            }
            for x in (0..pad).chain(pad + width..l.cols.len()) {
                if let Some(c) = l.cols[x] {
                    out[c] += flat[x];
                }
            }
        }
    }
}

/// Adds rows of one phase of the padded gradient to the input positions that the padding read.
fn add_phase<'a, T: Scalar>(
    l: &Layout,
    phase: usize,
    rows: impl Iterator<Item = (&'a [T], usize)>,
    first_row: usize,
    out: &mut [T],
) {
    let (a, b) = l.phases[phase];
    let (width, step, pad) = (l.input.w(), l.stride.1, l.padding().1);
    // Where the phase lies inside the image, between what the padding read.
    let first = pad.saturating_sub(b).div_ceil(step);
    let from = first * step + b - pad;
    let inner = width.saturating_sub(from).div_ceil(step).min(l.phase_w - first.min(l.phase_w));
    for (flat, y) in rows {
        let Some(row) = l.rows.get(y * l.stride.0 + a).copied().flatten() else { continue };
        let out = &mut out[(row - first_row) * width..][..width];
        let (inside, flat_inside) = (&mut out[from.min(width)..], &flat[first..][..inner]);
        if step == 2 {
            // The step of nearly all convolutions, in whole pairs: the compiler makes vectors of it.
            let (pairs, last) = inside.as_chunks_mut::<2>();
            pairs.iter_mut().zip(flat_inside).for_each(|(pair, &f)| pair[0] += f);
            last.iter_mut().zip(&flat_inside[pairs.len().min(inner)..]).for_each(|(d, &f)| *d += f);
        } else {
            inside.chunks_mut(step).zip(flat_inside).for_each(|(d, &f)| d[0] += f);
        }
        if l.pad_mode != PadMode::Zero {
            for x in (0..first).chain(first + inner..l.phase_w) {
                if let Some(c) = l.cols.get(x * step + b).copied().flatten() {
                    out[c] += flat[x];
                }
            }
        }
    }
}

/// A tile of rows of a block of input channels.
struct Unit<'a, T> {
    image: usize,
    group: usize,
    phase_rows: Range<usize>,
    first_row: usize,
    start: usize,
    width: usize,
    /// The rows of every channel.
    out: [&'a mut [T]; BLOCK],
}

/// Rows of the phase planes that make a tile, with the rows of the input that they write.
fn tiles(l: &Layout, tile_rows: usize) -> Vec<(Range<usize>, Range<usize>)> {
    let (pad, step, h) = (l.padding().0, l.stride.0, l.input.h());
    // Rows beyond the image have no reader when the border is zero.
    let all = if l.pad_mode == PadMode::Zero { pad / step..(pad + h).div_ceil(step) } else { 0..l.phase_h };
    // What a mirrored border adds to lies inside the first or the last tile.
    let least = if l.pad_mode == PadMode::Zero { 1 } else { (2 * pad + 1).div_ceil(step) + 1 };
    let tiles = ((all.end - all.start) / tile_rows.max(least)).max(1);
    let bounds: Vec<usize> = (0..=tiles).map(|i| all.start + (all.end - all.start) * i / tiles).collect();
    let row = |i: usize| match i {
        0 => 0,
        i if i == tiles => h,
        i => (bounds[i] * step).saturating_sub(pad).min(h),
    };
    (0..tiles).map(|i| (bounds[i]..bounds[i + 1], row(i)..row(i + 1))).collect()
}

fn units<'a, T>(l: &Layout, dx: &'a mut [T], tile_rows: usize) -> Vec<Unit<'a, T>> {
    let blocks = blocks(l.cin);
    let mut planes: Vec<_> = dx.chunks_exact_mut(l.input.plane()).collect();
    let mut units = Vec::new();
    let tiles = tiles(l, tile_rows);
    for image in 0..l.input.n() {
        for (phase_rows, rows) in &tiles {
            for group in 0..l.groups {
                for block in &blocks {
                    let mut out: [&mut [T]; BLOCK] = Default::default();
                    let first = (image * l.groups + group) * l.cin + block.start;
                    for (out, plane) in out.iter_mut().zip(&mut planes[first..first + block.width]) {
                        *out = plane.split_off_mut(..rows.len() * l.input.w()).expect("every plane has all tiles");
                    }
                    let (phase_rows, first_row) = (phase_rows.clone(), rows.start);
                    units.push(Unit { image, group, phase_rows, first_row, start: block.start, width: block.width, out });
                }
            }
        }
    }
    units
}
