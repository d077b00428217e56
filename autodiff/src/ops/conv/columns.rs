//! Maps of few positions, one group: a matrix product of the weights, as they are in memory, with the input's column matrix.
//!
//! Short rows fill no register of the direct product, least so where an image has a dozen positions. A column matrix puts the
//! positions of all rows and of several images side by side: `[channel][tap][position]`. It is made for some channels at a time,
//! which stay in the second-level cache, and multiplied by all outputs. A unit of work is some outputs. Every output is summed in
//! the order of the direct product, channel by channel and tap by tap, wherever it lies: bits are those of the direct product.

use std::sync::Arc;

use pulp::{Arch, Simd, WithSimd};

use super::after::After;
use super::backward_input::fold_phase;
use super::direct::{Direct, Tap, blocks, split};
use super::layout::Layout;
use crate::{PadMode, Pool, Scalar, par};

/// Positions whose columns are made together at most, unless one image has more.
const POSITIONS: usize = 512;
/// Elements of the column matrix that are made at a time, about: they stay in the second-level cache.
const ELEMENTS: usize = 1 << 17;
/// Positions that are multiplied at a time: three of the widest registers.
const PANEL: usize = 48;
/// Rows of the column matrix that are multiplied at a time: a panel of them stays in the nearest cache.
const ROWS: usize = 144;
/// Blocks of outputs of a unit.
const BLOCKS: usize = 4;
/// Channels whose columns are made as one item.
const CHANNELS: usize = 8;

/// `y = a(w * x + b)`.
pub fn forward<T: Scalar>(l: &Layout, x: &[T], w: &[T], after: After<'_, T>, pool: &Arc<Pool<T>>) -> Vec<T> {
    let packed = l.pack_input(x, pool);
    let mut y = pool.take(l.output.len());
    let task = Columns {
        x: &packed,
        channel_len: l.channel_len(),
        channels: l.cin,
        pitch: l.phase_w,
        taps: l.tap_offsets().into_iter().enumerate().map(|(weight, offset)| Tap { offset, weight }).collect(),
        w,
        steps: [l.cin * l.taps, l.taps],
        kernel: l.taps,
        after,
        outputs: l.cout,
        size: [l.output.h(), l.output.w()],
    };
    task.run(&mut y, pool);
    pool.give(packed);
    y
}

/// Fills `dx`, whatever it held: for every phase of the padded input the same sums over the output channels, of gradients with a
/// border.
pub fn backward_input<T: Scalar>(l: &Layout, g: &[T], w: &[T], dx: &mut [T], pool: &Arc<Pool<T>>) {
    let (bordered, pitch, channel_len) = l.pack_bordered_grad(g, pool);
    let (up, left) = l.reach();
    // No reader wants what falls outside the image, unless the padding read it from inside.
    let in_place = l.is_dense() && l.pad_mode == PadMode::Zero;
    let (above, before) = if in_place { l.padding() } else { (0, 0) };
    let size = if in_place { [l.input.h(), l.input.w()] } else { [l.phase_h, l.phase_w] };
    let mut padded = pool.take(if in_place { 0 } else { l.input.planes() * l.phase_len() });
    for phase in 0..l.phases.len() {
        let taps = l.tap_at.iter().enumerate().filter(|(_, tap)| tap.0 == phase);
        let offset = |y: usize, x: usize| (above + up - y) * pitch + before + left - x;
        let task = Columns {
            x: &bordered,
            channel_len,
            channels: l.cout,
            pitch,
            taps: taps.map(|(weight, &(_, y, x))| Tap { offset: offset(y, x), weight }).collect(),
            w,
            steps: [l.taps, l.cin * l.taps],
            kernel: l.taps,
            after: After::NOTHING,
            outputs: l.cin,
            size,
        };
        if in_place {
            task.run(dx, pool);
        } else {
            task.run(&mut padded, pool);
            fold_phase(l, phase, &padded, dx);
        }
    }
    pool.give(padded);
    pool.give(bordered);
}

/// One convolution.
struct Columns<'a, T> {
    /// Planes of `channel_len` elements, `[image][channel]`, in rows of `pitch`.
    x: &'a [T],
    channel_len: usize,
    channels: usize,
    pitch: usize,
    /// Where each tap reads for the first output position, within a plane.
    taps: Vec<Tap>,
    /// That of tap `t`, output `o`, channel `c` is at `o * steps[0] + c * steps[1] + t.weight`.
    w: &'a [T],
    steps: [usize; 2],
    /// Weights of one input and output channel.
    kernel: usize,
    after: After<'a, T>,
    outputs: usize,
    /// Rows and columns of an output plane.
    size: [usize; 2],
}

impl<T: Scalar> Columns<'_, T> {
    fn run(&self, out: &mut [T], pool: &Pool<T>) {
        let plane = self.size[0] * self.size[1];
        let images = (POSITIONS / plane).max(1);
        for (i, out) in out.chunks_mut(images * self.outputs * plane).enumerate() {
            self.images(&self.x[i * images * self.channels * self.channel_len..], out, pool);
        }
    }

    /// The outputs of some images, the first of which is the first of `x`.
    fn images(&self, x: &[T], out: &mut [T], pool: &Pool<T>) {
        let plane = self.size[0] * self.size[1];
        let len = out.len() / self.outputs;
        // Whole cache lines, an odd number of them: rows would share few places of the nearest cache otherwise. One more for what
        // registers write beyond the last position.
        let pitch = ((len.div_ceil(16) + 1) | 1) * 16;
        let taps = self.taps.len();
        let some = (ELEMENTS / (taps * pitch)).clamp(1, self.channels);
        let mut columns = pool.take(some * taps * pitch);
        let blocks = blocks(self.outputs);
        let block_len = len.div_ceil(PANEL) * PANEL;
        let mut sums = pool.take(self.outputs * block_len);
        // All rows as taps of one channel.
        let rows =
            (0..some * taps).map(|i| Tap { offset: i * pitch, weight: i / taps * self.steps[1] + self.taps[i % taps].weight });
        let rows: Vec<Tap> = rows.collect();
        for first in (0..self.channels).step_by(some) {
            let channels = some.min(self.channels - first);
            par::for_each_chunk(&mut columns[..channels * taps * pitch], CHANNELS * taps * pitch, |i, out| {
                T::run_gather(Gather {
                    x: &x[(first + i * CHANNELS) * self.channel_len..],
                    steps: [self.channel_len, self.channels * self.channel_len],
                    pitch: self.pitch,
                    taps: &self.taps,
                    images: len / plane,
                    size: self.size,
                    out,
                    out_pitch: pitch,
                });
            });
            let mut rest = &mut sums[..];
            let units = blocks.chunks(BLOCKS).map(|blocks| {
                let outputs: usize = blocks.iter().map(|block| block.width).sum();
                (blocks, rest.split_off_mut(..outputs * block_len).expect("every block has sums"))
            });
            par::for_each_item(units.collect(), |_, (blocks, sums)| {
                let start = blocks[0].start;
                for (i, rows) in rows[..channels * taps].chunks(ROWS).enumerate() {
                    for panel in 0..block_len / PANEL {
                        for block in blocks {
                            let at = (block.start - start) * block_len + panel * block.width * PANEL;
                            T::run_direct(Direct {
                                x: &columns[panel * PANEL..],
                                channel_len: 0,
                                channels: 1,
                                weights: &self.w[block.start * self.steps[0] + first * self.steps[1]..],
                                output_stride: self.steps[0],
                                channel_stride: 0,
                                taps: rows,
                                kernel: (channels - 1) * self.steps[1] + self.kernel,
                                rows: 1,
                                len: PANEL.min(len - panel * PANEL),
                                pitches: [0, 0],
                                out: &mut split(&mut sums[at..][..block.width * PANEL], block.width)[..block.width],
                                bias: &[],
                                add: first + i > 0,
                            });
                        }
                    }
                }
            });
        }
        pool.give(columns);
        par::for_each_chunk(out, plane, |i, mut out| {
            let (image, o) = (i / self.outputs, i % self.outputs);
            let block = blocks.iter().rfind(|block| block.start <= o).expect("every output is in a block");
            let bias = self.after.bias(o);
            let sums = &sums[block.start * block_len..][..block.width * block_len];
            let mut from = image * plane;
            while !out.is_empty() {
                let (panel, at) = (from / PANEL, from % PANEL);
                let some = out.split_off_mut(..out.len().min(PANEL - at)).expect("not beyond the plane");
                let sums = &sums[(panel * block.width + o - block.start) * PANEL + at..];
                some.iter_mut().zip(sums).for_each(|(y, &sum)| *y = sum + bias);
                self.after.activate(some);
                from += some.len();
            }
        });
        pool.give(sums);
    }
}

/// Makes rows of a column matrix.
pub struct Gather<'a, T> {
    /// Planes of the first channel and image, with a register's space behind the last one.
    x: &'a [T],
    /// Elements from a channel and from an image to the next.
    steps: [usize; 2],
    pitch: usize,
    taps: &'a [Tap],
    images: usize,
    /// Output rows and columns.
    size: [usize; 2],
    /// `[channel][tap][image][row][column]`, `out_pitch` elements to a tap, with a register's space behind the last position.
    out: &'a mut [T],
    out_pitch: usize,
}

impl<T: Scalar> Gather<'_, T> {
    /// Runs the kernel on the processor's widest registers.
    pub fn run(self) {
        Arch::new().dispatch(self);
    }
}

impl<T: Scalar> WithSimd for Gather<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let lanes = T::lanes::<S>();
        let [high, wide] = self.size;
        for (c, out) in self.out.chunks_exact_mut(self.taps.len() * self.out_pitch).enumerate() {
            for (out, tap) in out.chunks_exact_mut(self.out_pitch).zip(self.taps) {
                for image in 0..self.images {
                    let x = &self.x[c * self.steps[0] + image * self.steps[1] + tap.offset..];
                    for row in 0..high {
                        let (x, out) = (&x[row * self.pitch..], &mut out[(image * high + row) * wide..]);
                        // What a register writes beyond a row, the next one overwrites.
                        for at in (0..wide).step_by(lanes) {
                            T::store::<S>(&mut out[at..], T::load::<S>(&x[at..]));
                        }
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{backward_input as direct_input, forward as direct};
    use super::*;
    use crate::gradcheck::random;
    use crate::{Conv2d, Shape};

    /// Image, outputs, kernel and attributes: blocks not full, several panels, sums put down between, several groups of images.
    fn cases() -> Vec<(Shape, usize, usize, Conv2d)> {
        let dilated = Conv2d { dilation: (2, 1), ..Conv2d::new(1, 1) };
        vec![
            (Shape::new(1, 1, 3, 3), 1, 3, Conv2d::new(1, 0)),
            (Shape::new(4, 9, 2, 6), 37, 3, Conv2d::new(1, 1)),
            (Shape::new(20, 3, 5, 6), 9, 3, Conv2d::new(1, 1).reflect()),
            (Shape::new(2, 130, 6, 20), 11, 3, Conv2d::new(1, 1)),
            (Shape::new(3, 4, 7, 33), 2, 5, Conv2d::new(1, 2).replicate()),
            (Shape::new(2, 5, 9, 8), 6, 3, dilated),
            (Shape::new(2, 5, 9, 25), 70, 3, Conv2d::new(2, 1)),
            (Shape::new(3, 6, 10, 7), 8, 1, Conv2d::new(2, 0)),
            (Shape::new(1, 3, 14, 13), 5, 7, Conv2d::new(3, 3).reflect()),
        ]
    }

    fn layout(x: Shape, outputs: usize, kernel: usize, conv: &Conv2d) -> (Layout, Shape) {
        let w = Shape::new(outputs, x.c(), kernel, kernel);
        (Layout::new(x, w, conv.output_shape(x, w), conv), w)
    }

    fn equals_the_direct_product<T: Scalar>() {
        for (case, (shape, outputs, kernel, conv)) in cases().into_iter().enumerate() {
            let (l, weight) = layout(shape, outputs, kernel, &conv);
            let pool = Pool::<T>::new();
            let (x, w) = (random::<T>(1, shape, -1.0, 1.0), random::<T>(2, weight, -1.0, 1.0));
            let (b, g) = (random::<T>(3, Shape::new(1, outputs, 1, 1), -1.0, 1.0), random::<T>(4, l.output, -1.0, 1.0));
            for bias in [None, Some(b.data())] {
                let after = After { bias, ..After::NOTHING };
                let y = forward(&l, x.data(), w.data(), after, &pool);
                assert!(y == direct::forward(&l, x.data(), w.data(), after, &pool), "case {case}");
            }
            let mut dx = [(); 2].map(|()| vec![T::from_f64(f64::NAN); shape.len()]);
            backward_input(&l, g.data(), w.data(), &mut dx[0], &pool);
            direct_input::backward_input(&l, g.data(), w.data(), &mut dx[1], &pool);
            assert!(dx[0] == dx[1], "gradient, case {case}");
        }
    }

    #[test]
    fn bits_are_those_of_the_direct_product_in_both_precisions() {
        equals_the_direct_product::<f32>();
        equals_the_direct_product::<f64>();
    }

    #[test]
    fn bits_do_not_depend_on_threads_nor_on_other_images() {
        for (shape, outputs, kernel, conv) in cases() {
            let (l, weight) = layout(shape, outputs, kernel, &conv);
            let w = random::<f32>(2, weight, -1.0, 1.0);
            let (x, g) = (random::<f32>(1, shape, -1.0, 1.0), random::<f32>(4, l.output, -1.0, 1.0));
            let run = |threads, l: &Layout, x: &[f32], g: &[f32]| {
                par::with_threads(threads, || {
                    let pool = Pool::new();
                    let mut dx = vec![0.0; x.len()];
                    backward_input(l, g, w.data(), &mut dx, &pool);
                    (forward(l, x, w.data(), After::NOTHING, &pool), dx)
                })
            };
            let one = run(1, &l, x.data(), g.data());
            assert!((2..5).all(|threads| run(threads, &l, x.data(), g.data()) == one), "{shape}");
            let image = Shape::new(1, shape.c(), shape.h(), shape.w());
            let (alone, _) = layout(image, outputs, kernel, &conv);
            let last = (shape.len() - image.len(), l.output.len() - alone.output.len());
            let (y, dx) = run(1, &alone, &x.data()[last.0..], &g.data()[last.1..]);
            assert!(y == one.0[last.1..] && dx == one.1[last.0..], "last image of {shape}");
        }
    }
}
