//! The gradient of the weights of 3 x 3, stride 1, by Winograd's scheme F(3x3, 2x2): every 2 x 2 tile of output gradients takes 16
//! products instead of 36 (Lavin and Gray 2016, arXiv 1509.09308). It is the transpose of the scheme that makes outputs: with
//! `y = A' [(G w G') * (B' x B)] A` for a tile, `dw = G' [sum over tiles of (A dy A') * (B' x B)] G`.
//!
//! A unit of work owns the weights of some outputs and some input channels. It visits its rows of tiles, transforms both sides
//! into a block of tiles that stays in the second-level cache, and adds the block's products: 16 matrix products, summed over
//! tiles. Transforms are repeated for every group of the other side, which costs less than to write and read them back.
//!
//! A plane of zeros on either side gives exactly nothing. A tap that never reads the only input that is not zero, at a corner of
//! the image, is zero up to rounding only; one NaN reaches all nine taps of its channel.

use std::ops::Range;
use std::sync::Arc;

use super::layout::{Layout, source_indices};
use super::winograd_weight_kernels::{Factors, GROUP_LEN, GROUPED, PRODUCTS, STRIP, Sums, TAPS, Taps, Tiles};
use crate::{PadMode, Pool, Scalar, par};

/// Most outputs and most input channels of a unit.
const GROUP: usize = 64;
/// Tiles of a block at most, and those times its channels, about.
const TILES: usize = 160;
const BLOCK_SIZE: usize = 10_240;
/// Units that are enough for every thread to have some.
const UNITS: usize = 16;
/// Tiles that are worth a part, and most tiles of one: what a part sums stays in the element type.
const SMALL_PART: usize = 480;
const LARGE_PART: usize = 2048;
/// Weights whose parts are added at one time.
const SOME: usize = 64;

/// Adds the gradient of the weights.
pub fn backward_weight<T: Scalar>(l: &Layout, x: &[T], g: &[T], dw: &mut [T], pool: &Arc<Pool<T>>) {
    let [high, wide] = [l.output.h(), l.output.w()];
    let (rows, cols) = (source_indices(high, 0, PadMode::Zero), source_indices(wide, 0, PadMode::Zero));
    let sizes = Sizes::new(l);
    let inputs = Side { x, channels: l.cin, plane: l.input.plane(), width: l.input.w(), rows: &l.rows, cols: &l.cols, size: 4 };
    let gradients = Side { x: g, channels: l.cout, plane: high * wide, width: wide, rows: &rows, cols: &cols, size: 2 };
    par::for_each_item(units(dw, l.cin), |_, mut unit| {
        let len = unit.rows.len() * unit.channels * TAPS;
        let mut sums = pool.take(sizes.parts * len);
        par::for_each_chunk(&mut sums, len, |part, sums| {
            let rows = sizes.rows * part / sizes.parts..sizes.rows * (part + 1) / sizes.parts;
            let unit = [unit.first_output..unit.first_output + unit.rows.len(), unit.first..unit.first + unit.channels];
            add_part(&sizes, [&gradients, &inputs], unit, rows, sums, pool);
        });
        let row = unit.channels * TAPS;
        for (o, out) in unit.rows.iter_mut().enumerate() {
            if sizes.parts == 1 {
                out.iter_mut().zip(&sums[o * row..]).for_each(|(d, &sum)| *d += sum);
                continue;
            }
            for (i, out) in out.chunks_mut(SOME).enumerate() {
                let mut total = [0.0; SOME];
                for sums in sums.chunks_exact(len) {
                    total.iter_mut().zip(&sums[o * row + i * SOME..]).for_each(|(total, sum)| *total += sum.to_f64());
                }
                out.iter_mut().zip(total).for_each(|(d, total)| *d += T::from_f64(total));
            }
        }
        pool.give(sums);
    });
}

/// Weights of some outputs and some input channels.
struct Unit<'a, T> {
    first_output: usize,
    first: usize,
    channels: usize,
    /// Those of every output.
    rows: Vec<&'a mut [T]>,
}

fn units<T>(dw: &mut [T], channels: usize) -> Vec<Unit<'_, T>> {
    let mut units = Vec::new();
    let mut rows: Vec<_> = dw.chunks_exact_mut(channels * TAPS).map(|row| row.chunks_mut(GROUP * TAPS)).collect();
    for (group, rows) in rows.chunks_mut(GROUP).enumerate() {
        for first in (0..channels).step_by(GROUP) {
            let rows = rows.iter_mut().map(|row| row.next().expect("every row has all groups")).collect();
            units.push(Unit { first_output: group * GROUP, first, channels: GROUP.min(channels - first), rows });
        }
    }
    units
}

/// Tiles, and how they are cut.
struct Sizes {
    /// Rows of tiles in an image and in all images, columns of tiles.
    high: usize,
    rows: usize,
    wide: usize,
    /// Columns and rows of tiles of a block at most.
    piece: usize,
    block: usize,
    parts: usize,
}

impl Sizes {
    fn new(l: &Layout) -> Self {
        let (high, wide) = (l.output.h().div_ceil(2), l.output.w().div_ceil(2));
        let rows = l.output.n() * high;
        let units = l.cout.div_ceil(GROUP) * l.cin.div_ceil(GROUP);
        let worth = (rows * wide / SMALL_PART).min(UNITS / units);
        let parts = worth.max((rows * wide).div_ceil(LARGE_PART)).clamp(1, rows);
        let channels = [l.cin, l.cout].map(|c| c.min(GROUP).next_multiple_of(STRIP));
        let tiles = (BLOCK_SIZE / channels.iter().sum::<usize>()).min(TILES);
        let piece = wide.div_ceil(wide.div_ceil(tiles));
        Sizes { high, rows, wide, piece, block: tiles / piece, parts }
    }
}

/// Inputs or output gradients.
struct Side<'a, T> {
    x: &'a [T],
    channels: usize,
    plane: usize,
    width: usize,
    /// Source row and column of every padded row and column.
    rows: &'a [Option<usize>],
    cols: &'a [Option<usize>],
    /// Rows and columns of a patch.
    size: usize,
}

/// What a unit transforms of a side.
struct Transform<'a, T> {
    side: &'a Side<'a, T>,
    /// Channels of an image.
    channels: Range<usize>,
    /// `[strip][group]`, and elements of a strip.
    strip: usize,
    values: Vec<T>,
    /// Scratch: of all strips for inputs, which keep rows for the next tiles, of one for gradients.
    across: Vec<T>,
    across_len: usize,
}

impl<'a, T: Scalar> Transform<'a, T> {
    fn new(side: &'a Side<'a, T>, channels: Range<usize>, sizes: &Sizes, pool: &Pool<T>) -> Self {
        let strips = channels.len().div_ceil(STRIP);
        let strip = (sizes.block * sizes.piece).div_ceil(GROUPED) * GROUP_LEN;
        let across_len = Tiles::<T>::across(sizes.piece, side.size);
        let across = pool.take(across_len * if side.size > 2 { strips } else { 1 });
        Transform { side, channels, strip, values: pool.take(strips * strip), across, across_len }
    }

    /// Transforms a block: some columns of some rows of tiles, counted through all images. The block above is `known`.
    fn block(&mut self, high: usize, rows: &Range<usize>, cols: &Range<usize>, known: bool) {
        let side = self.side;
        for (i, c) in self.channels.clone().step_by(STRIP).enumerate() {
            let across = if side.size > 2 { i * self.across_len } else { 0 };
            let across = &mut self.across[across..][..Tiles::<T>::across(cols.len(), side.size)];
            for (at, row) in rows.clone().enumerate() {
                let (image, row) = (row / high, row % high);
                T::run_winograd_tiles(Tiles {
                    x: &side.x[(image * side.channels + c) * side.plane..],
                    plane: side.plane,
                    width: side.width,
                    channels: STRIP.min(self.channels.end - c),
                    rows: side.rows,
                    cols: side.cols,
                    pad: (side.cols.len() - side.width) / 2,
                    first: [2 * row, 2 * cols.start],
                    tiles: cols.len(),
                    size: side.size,
                    known: row > 0 && (known || at > 0),
                    across,
                    out: &mut self.values[i * self.strip..][..self.strip],
                    at: at * cols.len(),
                });
            }
        }
    }

    fn factors(&self) -> Factors<'_, T> {
        Factors { values: &self.values, strip: self.strip, channels: self.channels.len().next_multiple_of(STRIP) }
    }

    fn give(self, pool: &Pool<T>) {
        pool.give(self.values);
        pool.give(self.across);
    }
}

/// Fills the sums of some rows of tiles, `[output][channel][tap]`; `unit` names the outputs and the input channels.
fn add_part<T: Scalar>(
    sizes: &Sizes,
    [gradients, inputs]: [&Side<'_, T>; 2],
    [outputs, channels]: [Range<usize>; 2],
    rows: Range<usize>,
    sums: &mut [T],
    pool: &Pool<T>,
) {
    let real = channels.len();
    let mut g = Transform::new(gradients, outputs, sizes, pool);
    let mut x = Transform::new(inputs, channels, sizes, pool);
    let pitch = x.factors().channels;
    let step = g.factors().channels * pitch;
    let mut products = pool.take(PRODUCTS * step);
    let mut add = false;
    for cols in pieces(0..sizes.wide, sizes.piece) {
        for block in pieces(rows.clone(), sizes.block) {
            let known = block.start > rows.start;
            g.block(sizes.high, &block, &cols, known);
            x.block(sizes.high, &block, &cols, known);
            let tiles = block.len() * cols.len();
            T::run_winograd_sums(Sums { gradients: g.factors(), inputs: x.factors(), tiles, out: &mut products, add });
            add = true;
        }
    }
    T::run_winograd_taps(Taps { sums: &products, step, pitch, channels: real, out: sums });
    pool.give(products);
    g.give(pool);
    x.give(pool);
}

fn pieces(all: Range<usize>, most: usize) -> impl Iterator<Item = Range<usize>> {
    all.clone().step_by(most).map(move |first| first..all.end.min(first + most))
}

#[cfg(test)]
mod tests {
    use super::super::weight;
    use super::*;
    use crate::gradcheck::random;
    use crate::{Conv2d, Shape};

    /// Image, outputs and attributes: odd and even sizes, one block and several, pieces of rows, groups and strips not full, parts.
    fn cases() -> Vec<(Shape, usize, Conv2d)> {
        let padded = |rows, columns| Conv2d { padding: (rows, columns), ..Conv2d::default() };
        vec![
            (Shape::new(1, 1, 3, 3), 1, padded(0, 0)),
            (Shape::new(2, 3, 5, 6), 9, padded(1, 1)),
            (Shape::new(3, 5, 4, 7), 18, padded(2, 0)),
            (Shape::new(1, 9, 37, 41), 70, padded(1, 2)),
            (Shape::new(2, 130, 6, 5), 67, padded(1, 1)),
            (Shape::new(3, 20, 45, 39), 35, padded(0, 1)),
            (Shape::new(2, 3, 31, 22), 4, padded(1, 1).reflect()),
            (Shape::new(1, 21, 7, 350), 2, padded(2, 1).reflect()),
            (Shape::new(2, 18, 6, 1), 3, padded(1, 2).replicate()),
            (Shape::new(2, 17, 34, 70), 33, padded(1, 1).replicate()),
        ]
    }

    fn layout(x: Shape, outputs: usize, conv: &Conv2d) -> Layout {
        let w = Shape::new(outputs, x.c(), 3, 3);
        let l = Layout::new(x, w, conv.output_shape(x, w), conv);
        assert!(l.is_winograd());
        l
    }

    /// What both ways add to the same numbers.
    fn both<T: Scalar>(l: &Layout, x: &[T], g: &[T]) -> [Vec<T>; 2] {
        let pool = Pool::new();
        // What an earlier user left in a buffer must not matter.
        for _ in 0..8 {
            let mut junk: Vec<_> = [1, 4, 9].map(|size| pool.take(size * PRODUCTS * 4096)).into();
            junk.iter_mut().for_each(|junk| junk.fill(T::from_f64(f64::NAN)));
            junk.into_iter().for_each(|junk| pool.give(junk));
        }
        let mut dw = [(); 2].map(|()| vec![T::from_f64(0.5); l.cout * l.cin * TAPS]);
        backward_weight(l, x, g, &mut dw[0], &pool);
        weight::backward_weight(l, x, g, &mut dw[1], &pool);
        dw
    }

    fn equals_the_direct_sum<T: Scalar>(tolerance: f64) {
        for (case, (shape, outputs, conv)) in cases().into_iter().enumerate() {
            let l = layout(shape, outputs, &conv);
            let (x, g) = (random::<T>(1, shape, -1.0, 1.0), random::<T>(4, l.output, -1.0, 1.0));
            let [found, wanted] = both(&l, x.data(), g.data());
            let tolerance = tolerance * ((l.output.n() * l.output.plane()) as f64).sqrt();
            for (i, (a, b)) in found.iter().zip(&wanted).enumerate() {
                let error = (a.to_f64() - b.to_f64()).abs();
                assert!(error < tolerance, "case {case}, weight {i}: {a} against {b}");
            }
        }
    }

    #[test]
    fn equals_the_direct_sum_in_both_precisions() {
        equals_the_direct_sum::<f32>(2e-6);
        equals_the_direct_sum::<f64>(4e-15);
    }

    #[test]
    fn planes_of_zeros_give_exactly_nothing() {
        let l = layout(Shape::new(2, 18, 13, 21), 20, &Conv2d::new(1, 1));
        let (mut x, mut g) = (random::<f32>(1, l.input, -1.0, 1.0), random::<f32>(4, l.output, -1.0, 1.0));
        for n in 0..2 {
            x.make_mut()[(n * 18 + 17) * l.input.plane()..][..l.input.plane()].fill(0.0);
            g.make_mut()[(n * 20 + 3) * l.output.plane()..][..l.output.plane()].fill(0.0);
        }
        for dw in both(&l, x.data(), g.data()) {
            for (i, &d) in dw.iter().enumerate() {
                let (o, c) = (i / (18 * TAPS), i / TAPS % 18);
                assert_eq!(d == 0.5, o == 3 || c == 17, "output {o}, input {c}");
            }
        }
    }

    #[test]
    fn bits_do_not_depend_on_the_number_of_threads() {
        for (shape, outputs, conv) in cases() {
            let l = layout(shape, outputs, &conv);
            let (x, g) = (random::<f32>(1, shape, -1.0, 1.0), random::<f32>(4, l.output, -1.0, 1.0));
            let run = |threads| {
                par::with_threads(threads, || {
                    let mut dw = vec![0.0; l.cout * l.cin * TAPS];
                    backward_weight(&l, x.data(), g.data(), &mut dw, &Pool::new());
                    dw
                })
            };
            let one = run(1);
            assert!((2..5).all(|threads| run(threads) == one), "{shape}");
        }
    }
}
