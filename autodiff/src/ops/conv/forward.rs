//! The forward pass by the direct product. A unit of work is a tile of rows of one image and a block of output channels.

use std::sync::Arc;

use super::after::After;
use super::direct::{BLOCK, Direct, Tap, blocks, padded_len};
use super::layout::Layout;
use crate::{Pool, Scalar, par};

/// Output positions of a tile at most, about.
const POSITIONS: usize = 2048;
/// Elements that the output blocks of a tile read, about: they stay in the second-level cache from one block to the next.
const READ: usize = 1 << 17;

/// Rows of a tile whose every position reads so many elements, in rows of `pitch`.
pub fn tile_rows(pitch: usize, elements: usize) -> usize {
    POSITIONS.min(READ / elements).div_ceil(pitch)
}

/// `y = a(w * x + b)`.
pub fn forward<T: Scalar>(l: &Layout, x: &[T], w: &[T], after: After<'_, T>, pool: &Arc<Pool<T>>) -> Vec<T> {
    let packed = l.pack_input(x, pool);
    let taps: Vec<Tap> = l.tap_offsets().into_iter().enumerate().map(|(weight, offset)| Tap { offset, weight }).collect();
    let per_output = l.cin * l.taps;
    let mut y = pool.take(l.output.len());
    let tile_rows = tile_rows(l.phase_w, l.cin * l.phases.len());
    let wo = l.output.w();
    par::for_each_item(units(l, &mut y, tile_rows), |_, mut unit| {
        let rows = unit.out[0].len() / wo;
        let len = (rows - 1) * l.phase_w + wo;
        let pitch = padded_len(len);
        let mut scratch = pool.take(unit.width * pitch);
        let first = unit.group * l.cout + unit.start;
        T::run_direct(Direct {
            x: &packed[(unit.image * l.groups + unit.group) * l.cin * l.channel_len() + unit.first_row * l.phase_w..],
            channel_len: l.channel_len(),
            channels: l.cin,
            weights: &w[first * per_output..],
            output_stride: per_output,
            channel_stride: l.taps,
            taps: &taps,
            kernel: l.taps,
            len,
            out: &mut scratch,
            width: unit.width,
            add: false,
        });
        for (o, (out, flat)) in unit.out.iter_mut().zip(scratch.chunks_exact(pitch)).enumerate() {
            let b = after.bias(first + o);
            for (row, flat) in out.chunks_exact_mut(wo).zip(flat.chunks(l.phase_w)) {
                for (y, &f) in row.iter_mut().zip(flat) {
                    *y = f + b;
                }
            }
            after.activate(out);
        }
        pool.give(scratch);
    });
    pool.give(packed);
    y
}

/// A tile of rows of a block of output channels.
struct Unit<'a, T> {
    image: usize,
    group: usize,
    first_row: usize,
    start: usize,
    width: usize,
    /// The rows of every channel.
    out: [&'a mut [T]; BLOCK],
}

fn units<'a, T>(l: &Layout, y: &'a mut [T], tile_rows: usize) -> Vec<Unit<'a, T>> {
    let blocks = blocks(l.cout);
    let mut planes: Vec<_> = y.chunks_exact_mut(l.output.plane()).map(|p| p.chunks_mut(tile_rows * l.output.w())).collect();
    let mut units = Vec::new();
    for image in 0..l.output.n() {
        for first_row in (0..l.output.h()).step_by(tile_rows) {
            for group in 0..l.groups {
                for block in &blocks {
                    let mut out: [&mut [T]; BLOCK] = Default::default();
                    let first = (image * l.groups + group) * l.cout + block.start;
                    for (out, plane) in out.iter_mut().zip(&mut planes[first..first + block.width]) {
                        *out = plane.next().expect("every plane has all tiles");
                    }
                    units.push(Unit { image, group, first_row, start: block.start, width: block.width, out });
                }
            }
        }
    }
    units
}
