//! Kernels of 3 x 3 by Winograd's scheme F(2x2, 3x3): every 2 x 2 tile of outputs takes 16 products instead of 36 (Lavin and Gray
//! 2016, arXiv 1509.09308), with stride 2 by a scheme of 25. Numbers are only halved, added and multiplied, and no output depends
//! on an input outside its own 3 x 3 window: zeros and NaN go no further than in the direct product.
//!
//! Inputs are transformed into planes of tiles, weights into 16 planes, and each product of planes is one of matrices. A unit of
//! work is a block of rows of tiles with all outputs, whose planes stay in the second-level cache; where there are few such
//! blocks, it is a block and a group of outputs, and the inputs are transformed before.

use std::ops::Range;
use std::sync::Arc;

use super::after::After;
use super::backward_input::store_dense;
use super::layout::{Layout, source_indices};
use super::winograd_kernels::{INPUT_PLANES, Inputs, Outputs, WEIGHT_PLANES, Weights};
use super::winograd_products::{BLOCK, Products, SUMMED};
use super::winograd_schemes::Kind;
use crate::{PadMode, Pool, Scalar, par};

/// Most outputs of a unit.
const GROUP: usize = 64;
/// Tiles of a block times input channels, about.
const BLOCK_SIZE: usize = 12_288;
/// Blocks that are enough for every thread to have some.
const ENOUGH: usize = 4;
/// Elements between products: they would share one place of the nearest cache otherwise.
const SKEW: usize = 16;
/// Input channels that are transformed as one item.
const CHANNELS: usize = 8;
/// `y = a(w * x + b)`.
pub fn forward<T: Scalar>(l: &Layout, x: &[T], w: &[T], after: After<'_, T>, pool: &Arc<Pool<T>>) -> Vec<T> {
    let mut y = pool.take(l.output.len());
    let task = Winograd {
        kind: if l.is_dense() { Kind::Dense } else { Kind::Strided },
        x,
        size: [l.input.n(), l.cin, l.input.h(), l.input.w()],
        rows: &l.rows,
        cols: &l.cols,
        w,
        steps: [l.cin * l.taps, l.taps],
        turned: false,
        after,
        outputs: l.cout,
        out_size: [l.output.h(), l.output.w()],
        skip: [0, 0],
    };
    task.run(&mut y, pool);
    y
}

/// Fills `dx`, whatever it held: the same kind of sums, of the output gradient with a border, by the weights turned.
pub fn backward_input<T: Scalar>(l: &Layout, g: &[T], w: &[T], dx: &mut [T], pool: &Arc<Pool<T>>) {
    // No reader wants what falls outside the image, unless the padding read it from inside.
    let zero = l.pad_mode == PadMode::Zero;
    let (above, before) = if zero { l.padding() } else { (0, 0) };
    let out_size = if zero { [l.input.h(), l.input.w()] } else { [l.rows.len(), l.cols.len()] };
    let [n, h, w_out] = [l.output.n(), l.output.h(), l.output.w()];
    // With stride 1, a tile may start anywhere; else those of the padded image do.
    let (kind, border, skip) =
        if l.is_dense() { (Kind::Dense, [2 - above, 2 - before], [0, 0]) } else { (Kind::StridedInput, [1, 1], [above, before]) };
    let task = Winograd {
        kind,
        x: g,
        size: [n, l.cout, h, w_out],
        rows: &source_indices(h, border[0], PadMode::Zero),
        cols: &source_indices(w_out, border[1], PadMode::Zero),
        w,
        steps: [l.taps, l.cin * l.taps],
        turned: true,
        after: After::NOTHING,
        outputs: l.cin,
        out_size,
        skip,
    };
    if zero {
        task.run(dx, pool);
        return;
    }
    let [high, wide] = out_size;
    let mut padded = pool.take(l.input.planes() * high * wide);
    task.run(&mut padded, pool);
    par::for_each_chunk(dx, l.input.plane(), |i, dx| {
        store_dense(l, padded[i * high * wide..].chunks_exact(wide).zip(0..high), 0, dx);
    });
    pool.give(padded);
}

/// One convolution.
struct Winograd<'a, T> {
    kind: Kind,
    x: &'a [T],
    /// Images, channels, rows and columns of `x`.
    size: [usize; 4],
    /// Source row and column of every padded row and column.
    rows: &'a [Option<usize>],
    cols: &'a [Option<usize>],
    /// Weights: see [`Weights`].
    w: &'a [T],
    steps: [usize; 2],
    turned: bool,
    after: After<'a, T>,
    outputs: usize,
    /// Rows and columns of an output plane.
    out_size: [usize; 2],
    /// Rows and columns of the first tiles that lie before it.
    skip: [usize; 2],
}

/// A block of rows of tiles with a group of outputs.
struct Part<'a, T> {
    block: usize,
    group: usize,
    /// The block's rows of every output of the group, span by span.
    out: Vec<&'a mut [T]>,
}

/// Sizes of the transformed planes.
struct Sizes {
    /// Rows of tiles in an image and in a block at most, columns of tiles.
    high: usize,
    block: usize,
    wide: usize,
    /// Elements of a channel's plane in a block, and of a plane of all channels.
    pitch: usize,
    step: usize,
    /// Blocks, groups of outputs, outputs in a group.
    blocks: usize,
    groups: usize,
    group: usize,
    /// Elements of a plane of weights, of a group and [`SUMMED`] channels.
    weights_step: usize,
    /// Planes of transformed inputs.
    planes: usize,
}

impl<T: Scalar> Winograd<'_, T> {
    fn sizes(&self) -> Sizes {
        let [images, channels, ..] = self.size;
        let scheme = self.kind.scheme();
        let [high, wide] = [0, 1].map(|i| (self.skip[i] + self.out_size[i]).div_ceil(scheme.outputs));
        let count = |least: usize| {
            let rows = (BLOCK_SIZE / channels).clamp(least, 192) / wide;
            (images * high).div_ceil(rows.max(1))
        };
        // Blocks that share their inputs are better large.
        let blocks = if count(64) < ENOUGH { count(128) } else { count(64) };
        let block = (images * high).div_ceil(blocks);
        // Whole cache lines, an odd number of them: channels would share few places of the nearest cache otherwise.
        let lines = ((block - 1) * wide + wide.next_multiple_of(16)).div_ceil(16);
        let pitch = if lines > 3 { lines | 1 } else { lines } * 16;
        let blocks = (images * high).div_ceil(block);
        let group = if blocks < ENOUGH { GROUP } else { GROUP / 2 };
        Sizes {
            high,
            block,
            wide,
            pitch,
            step: channels * pitch + SKEW,
            blocks,
            groups: self.outputs.div_ceil(group),
            group,
            weights_step: channels.min(SUMMED) * group + SKEW,
            planes: scheme.inputs.pow(2),
        }
    }

    fn run(&self, out: &mut [T], pool: &Arc<Pool<T>>) {
        let sizes = self.sizes();
        let (blocks, groups) = (sizes.blocks, sizes.groups);
        // Weights that several blocks need.
        let weights = (blocks > 1).then(|| {
            let sums = self.size[1].div_ceil(SUMMED);
            let mut all = pool.take(groups * sums * WEIGHT_PLANES * sizes.weights_step);
            par::for_each_chunk(&mut all, WEIGHT_PLANES * sizes.weights_step, |i, out| {
                self.transform_weights(&sizes, i / sums, i % sums * SUMMED, out)
            });
            all
        });
        // Inputs that several units need.
        let inputs = (blocks < ENOUGH).then(|| {
            let mut all = pool.take(blocks * sizes.planes * sizes.step);
            let blocks = all.chunks_exact_mut(sizes.planes * sizes.step).enumerate();
            let items = blocks.flat_map(|(block, all)| channel_items(all, &sizes).into_iter().map(move |item| (block, item)));
            par::for_each_item(items.collect(), |i, (block, mut item)| {
                let first = i % self.size[1].div_ceil(CHANNELS) * CHANNELS;
                self.transform_inputs(&sizes, block, first, &mut item, pool);
            });
            all
        });
        let together = if inputs.is_some() { 1 } else { groups };
        let mut parts = self.parts(&sizes, out).into_iter();
        let units: Vec<Vec<_>> = (0..blocks * groups / together).map(|_| parts.by_ref().take(together).collect()).collect();
        par::for_each_item(units, |_, unit| {
            let own = inputs.is_none().then(|| {
                let mut own = pool.take(sizes.planes * sizes.step);
                for (i, mut item) in channel_items(&mut own, &sizes).into_iter().enumerate() {
                    self.transform_inputs(&sizes, unit[0].block, i * CHANNELS, &mut item, pool);
                }
                own
            });
            for part in unit {
                let inputs = match (&own, &inputs) {
                    (Some(own), _) => own,
                    (_, all) => &all.as_deref().expect("transformed before")[part.block * sizes.planes * sizes.step..],
                };
                self.multiply(&sizes, inputs, weights.as_deref(), part, pool);
            }
            own.into_iter().for_each(|own| pool.give(own));
        });
        weights.into_iter().chain(inputs).for_each(|buffer| pool.give(buffer));
    }

    /// Images of a block, with their rows of tiles.
    fn spans(&self, sizes: &Sizes, block: usize) -> Vec<(usize, Range<usize>)> {
        let (mut row, end) = (block * sizes.block, (self.size[0] * sizes.high).min((block + 1) * sizes.block));
        let mut spans = Vec::new();
        while row < end {
            let (image, first) = (row / sizes.high, row % sizes.high);
            let rows = (end - row).min(sizes.high - first);
            spans.push((image, first..first + rows));
            row += rows;
        }
        spans
    }

    /// The output, block by block, group by group.
    fn parts<'a>(&self, sizes: &Sizes, out: &'a mut [T]) -> Vec<Part<'a, T>> {
        let [high, wide] = self.out_size;
        let outputs = self.kind.scheme().outputs;
        let mut planes: Vec<_> = out.chunks_exact_mut(high * wide).collect();
        let mut parts = Vec::new();
        for block in 0..sizes.blocks {
            let spans = self.spans(sizes, block);
            for group in 0..sizes.groups {
                let mut out = Vec::new();
                for (image, rows) in &spans {
                    let row = |tile: usize| (tile * outputs).saturating_sub(self.skip[0]).min(high);
                    let len = (row(rows.end) - row(rows.start)) * wide;
                    let first = image * self.outputs + group * sizes.group;
                    for plane in &mut planes[first..first + self.outputs_of(sizes, group)] {
                        out.push(plane.split_off_mut(..len).expect("every plane has all blocks"));
                    }
                }
                parts.push(Part { block, group, out });
            }
        }
        parts
    }

    fn outputs_of(&self, sizes: &Sizes, group: usize) -> usize {
        sizes.group.min(self.outputs - group * sizes.group)
    }

    /// Weights of a group and of up to [`SUMMED`] channels from `first` on.
    fn transform_weights(&self, sizes: &Sizes, group: usize, first: usize, out: &mut [T]) {
        T::run_winograd_weights(Weights {
            kind: self.kind,
            w: &self.w[group * sizes.group * self.steps[0] + first * self.steps[1]..],
            steps: self.steps,
            turned: self.turned,
            outputs: self.outputs_of(sizes, group),
            channels: SUMMED.min(self.size[1] - first),
            out,
            step: sizes.weights_step,
        });
    }

    /// Some channels of a block from `first` on.
    fn transform_inputs(&self, sizes: &Sizes, block: usize, first: usize, out: &mut Item<'_, T>, pool: &Pool<T>) {
        let [_, channels, high, wide] = self.size;
        let (plane, step) = (high * wide, self.kind.scheme().step);
        let mut scratch = pool.take(Inputs::<T>::scratch(self.kind, [sizes.block, sizes.wide]));
        let spans = self.spans(sizes, block);
        for c in first..channels.min(first + CHANNELS) {
            let mut start = (c - first) * sizes.pitch;
            for (image, rows) in spans.iter().cloned() {
                let tiles = [rows.len(), sizes.wide];
                T::run_winograd_inputs(Inputs {
                    kind: self.kind,
                    x: &self.x[(image * channels + c) * plane..][..plane],
                    width: wide,
                    rows: &self.rows[step * rows.start..],
                    cols: self.cols,
                    pad: (self.cols.len() - wide) / 2,
                    tiles,
                    scratch: &mut scratch[..Inputs::<T>::scratch(self.kind, tiles)],
                    out,
                    start,
                });
                start += rows.len() * sizes.wide;
            }
        }
        pool.give(scratch);
    }

    /// The products of a block and a group, and the outputs from them. Transforms weights where they were not before.
    fn multiply(&self, sizes: &Sizes, inputs: &[T], all_weights: Option<&[T]>, mut part: Part<'_, T>, pool: &Pool<T>) {
        let channels = self.size[1];
        let count = self.outputs_of(sizes, part.group);
        let outputs = count.next_multiple_of(BLOCK);
        let spans = self.spans(sizes, part.block);
        let mut sums = pool.take(self.kind.scheme().sums.len().pow(2) * outputs * sizes.pitch);
        let mut own = pool.take(if all_weights.is_some() { 0 } else { WEIGHT_PLANES * sizes.weights_step });
        for (i, first) in (0..channels).step_by(SUMMED).enumerate() {
            let weights = match all_weights {
                Some(all) => {
                    &all[(part.group * channels.div_ceil(SUMMED) + i) * WEIGHT_PLANES * sizes.weights_step..]
                        [..WEIGHT_PLANES * sizes.weights_step]
                }
                None => {
                    self.transform_weights(sizes, part.group, first, &mut own);
                    &own
                }
            };
            T::run_winograd_products(Products {
                kind: self.kind,
                weights,
                weights_step: sizes.weights_step,
                inputs: &inputs[first * sizes.pitch..],
                step: sizes.step,
                pitch: sizes.pitch,
                channels: SUMMED.min(channels - first),
                len: spans.iter().map(|(_, rows)| rows.len() * sizes.wide).sum(),
                outputs,
                out: &mut sums,
                add: first > 0,
            });
        }
        pool.give(own);
        let mut scratch = pool.take(Outputs::<T>::scratch(self.kind, sizes.wide));
        let mut start = 0;
        for ((_, rows), out) in spans.iter().zip(part.out.chunks_exact_mut(count)) {
            for (o, out) in out.iter_mut().enumerate() {
                T::run_winograd_outputs(Outputs {
                    kind: self.kind,
                    sums: &sums[o * sizes.pitch + start..],
                    step: outputs * sizes.pitch,
                    tiles: sizes.wide,
                    skip: [if rows.start == 0 { self.skip[0] } else { 0 }, self.skip[1]],
                    bias: self.after.bias(part.group * sizes.group + o),
                    scratch: &mut scratch,
                    out,
                    width: self.out_size[1],
                });
                self.after.activate(out);
            }
            start += rows.len() * sizes.wide;
        }
        pool.give(scratch);
        pool.give(sums);
    }
}

/// Some channels of every plane.
type Item<'a, T> = [&'a mut [T]; INPUT_PLANES];

/// The planes of a block, [`CHANNELS`] channels to an item.
fn channel_items<'a, T>(planes: &'a mut [T], sizes: &Sizes) -> Vec<Item<'a, T>> {
    let len = sizes.step - SKEW;
    let channels = len / sizes.pitch;
    let mut items: Vec<Item<'a, T>> = (0..channels.div_ceil(CHANNELS)).map(|_| Default::default()).collect();
    for (i, planes) in planes.chunks_exact_mut(sizes.step).enumerate() {
        for (item, some) in items.iter_mut().zip(planes[..len].chunks_mut(CHANNELS * sizes.pitch)) {
            item[i] = some;
        }
    }
    items
}

#[cfg(test)]
mod tests {
    use super::super::{backward_input as direct_input, forward as direct};
    use super::*;
    use crate::gradcheck::random;
    use crate::{Conv2d, Shape, Tensor};

    /// Image, outputs and attributes: odd and even sizes, one block and several, groups not full, sums put down between.
    fn cases() -> Vec<(Shape, usize, Conv2d)> {
        let padded = |rows, columns| Conv2d { padding: (rows, columns), ..Conv2d::default() };
        let strided = |rows, columns| Conv2d { stride: (2, 2), ..padded(rows, columns) };
        vec![
            (Shape::new(1, 1, 3, 3), 1, padded(0, 0)),
            (Shape::new(2, 3, 5, 6), 9, padded(1, 1)),
            (Shape::new(3, 5, 4, 7), 3, padded(2, 0)),
            (Shape::new(1, 9, 37, 41), 70, padded(1, 2)),
            (Shape::new(2, 130, 6, 5), 67, padded(1, 1)),
            (Shape::new(2, 3, 31, 22), 4, padded(1, 1).reflect()),
            (Shape::new(1, 4, 7, 150), 2, padded(2, 1).reflect()),
            (Shape::new(2, 2, 6, 1), 3, padded(1, 2).replicate()),
            (Shape::new(1, 1, 3, 3), 1, strided(0, 0)),
            (Shape::new(2, 3, 5, 6), 9, strided(1, 1)),
            (Shape::new(3, 5, 4, 7), 3, strided(2, 0)),
            (Shape::new(1, 9, 73, 82), 70, strided(1, 2)),
            (Shape::new(2, 130, 12, 9), 67, strided(1, 1)),
            (Shape::new(2, 3, 61, 44), 4, strided(1, 1).reflect()),
            (Shape::new(1, 4, 14, 301), 2, strided(2, 1).reflect()),
            (Shape::new(2, 2, 6, 1), 3, strided(1, 2).replicate()),
        ]
    }

    fn layout(x: Shape, outputs: usize, conv: &Conv2d) -> (Layout, Shape) {
        let w = Shape::new(outputs, x.c(), 3, 3);
        let l = Layout::new(x, w, conv.output_shape(x, w), conv);
        assert!(l.is_winograd() || l.is_winograd_strided());
        (l, w)
    }

    fn equals_the_direct_product<T: Scalar>(tolerance: f64) {
        for (case, (shape, outputs, conv)) in cases().into_iter().enumerate() {
            let (l, weight) = layout(shape, outputs, &conv);
            let (pool, channels) = (Pool::<T>::new(), shape.c());
            let (x, w) = (random::<T>(1, shape, -1.0, 1.0), random::<T>(2, weight, -1.0, 1.0));
            let (b, g) = (random::<T>(3, Shape::new(1, outputs, 1, 1), -1.0, 1.0), random::<T>(4, l.output, -1.0, 1.0));
            let close = |found: &[T], wanted: &[T], sums: usize| {
                for (a, b) in found.iter().zip(wanted) {
                    let error = (a.to_f64() - b.to_f64()).abs();
                    assert!(error < tolerance * (9.0 * sums as f64).sqrt(), "case {case}: {a} against {b}");
                }
            };
            let bias = After { bias: Some(b.data()), ..After::NOTHING };
            let y = forward(&l, x.data(), w.data(), bias, &pool);
            close(&y, &direct::forward(&l, x.data(), w.data(), bias, &pool), channels);
            let mut dx = [(); 2].map(|()| vec![T::from_f64(f64::NAN); shape.len()]);
            backward_input(&l, g.data(), w.data(), &mut dx[0], &pool);
            direct_input::backward_input(&l, g.data(), w.data(), &mut dx[1], &pool);
            close(&dx[0], &dx[1], outputs);
        }
    }

    #[test]
    fn equals_the_direct_product_in_both_precisions() {
        equals_the_direct_product::<f32>(2e-6);
        equals_the_direct_product::<f64>(4e-15);
    }

    /// Transformed tiles hold four outputs: what one of them does not read must not reach it.
    #[test]
    fn zeros_and_nan_go_no_further_than_in_the_direct_product() {
        for stride in [1, 2] {
            let (l, weight) = layout(Shape::new(1, 2, 9, 12), 3, &Conv2d::new(stride, 1));
            let (pool, w) = (Pool::<f32>::new(), random::<f32>(2, weight, -1.0, 1.0));
            for at in 0..l.input.plane() {
                for background in [0.0, 1.0] {
                    let lone = Tensor::from_fn(l.input, |_, c, i, j| match (c == 1 && i * 12 + j == at, background == 0.0) {
                        (true, true) => 0.7,
                        (true, false) => f32::NAN,
                        _ => background,
                    });
                    let (found, wanted) = (
                        forward(&l, lone.data(), w.data(), After::NOTHING, &pool),
                        direct::forward(&l, lone.data(), w.data(), After::NOTHING, &pool),
                    );
                    let same = |(a, b): (&f32, &f32)| (*a == 0.0) == (*b == 0.0) && a.is_nan() == b.is_nan();
                    assert!(found.iter().zip(&wanted).all(same), "lone input {at} on {background}, stride {stride}");
                }
            }
        }
    }

    #[test]
    fn bits_do_not_depend_on_the_number_of_threads() {
        for (shape, outputs, conv) in cases() {
            let (l, weight) = layout(shape, outputs, &conv);
            let (x, w) = (random::<f32>(1, shape, -1.0, 1.0), random::<f32>(2, weight, -1.0, 1.0));
            let g = random::<f32>(4, l.output, -1.0, 1.0);
            let run = |threads| {
                par::with_threads(threads, || {
                    let pool = Pool::new();
                    let mut dx = vec![0.0; shape.len()];
                    backward_input(&l, g.data(), w.data(), &mut dx, &pool);
                    (forward(&l, x.data(), w.data(), After::NOTHING, &pool), dx)
                })
            };
            let one = run(1);
            assert!((2..5).all(|threads| run(threads) == one), "{shape}");
        }
    }
}
