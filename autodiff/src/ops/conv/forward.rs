//! The forward pass by the direct product. A unit of work is a tile of rows of one image and a block of output channels, which is
//! written in place where its rows are whole registers.

use std::sync::Arc;

use super::after::After;
use super::direct::{BLOCK, Direct, Tap, blocks, padded_len, split};
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
        let first = unit.group * l.cout + unit.start;
        let image = &packed[(unit.image * l.groups + unit.group) * l.cin * l.channel_len()..];
        let mut biases = [T::ZERO; BLOCK];
        biases.iter_mut().zip(first..first + unit.width).for_each(|(b, o)| *b = after.bias(o));
        let direct = Direct {
            x: &image[unit.first_row * l.phase_w..],
            channel_len: l.channel_len(),
            channels: l.cin,
            weights: &w[first * per_output..],
            output_stride: per_output,
            channel_stride: l.taps,
            taps: &taps,
            kernel: l.taps,
            rows,
            len: wo,
            pitches: [l.phase_w, wo],
            out: &mut unit.out[..unit.width],
            bias: &biases[..unit.width],
            add: false,
        };
        if padded_len(wo) == wo {
            T::run_direct(direct);
        } else {
            // Registers would reach beyond a row: all rows as one, from which they are taken.
            let len = (rows - 1) * l.phase_w + wo;
            let mut scratch = pool.take(unit.width * padded_len(len));
            let mut flat = split(&mut scratch, unit.width);
            T::run_direct(Direct { rows: 1, len, pitches: [0, 0], out: &mut flat[..unit.width], ..direct });
            for (out, flat) in unit.out.iter_mut().zip(&flat[..unit.width]) {
                for (row, flat) in out.chunks_exact_mut(wo).zip(flat.chunks(l.phase_w)) {
                    row.copy_from_slice(&flat[..wo]);
                }
            }
            pool.give(scratch);
        }
        unit.out[..unit.width].iter_mut().for_each(|out| after.activate(out));
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

#[cfg(test)]
mod tests {
    use super::super::backward_input::backward_input;
    use super::*;
    use crate::gradcheck::random;
    use crate::{Activation, Conv2d, Shape, Tensor};

    /// The same planes with columns of zeros behind them.
    fn wider<T: Scalar>(x: &Tensor<T>, columns: usize) -> Tensor<T> {
        let s = x.shape();
        let shape = Shape::new(s.n(), s.c(), s.h(), s.w() + columns);
        Tensor::from_fn(shape, |n, c, i, j| if j < s.w() { x.at(n, c, i, j) } else { T::ZERO })
    }

    /// Rows of whole registers are written where they belong, others are copied there: columns of zeros that make them longer
    /// change nothing in front of them.
    #[test]
    fn rows_of_whole_registers_have_the_bits_of_longer_ones() {
        for (shape, outputs, kernel, conv) in [
            (Shape::new(2, 3, 5, 16), 15, 3, Conv2d::new(1, 1)),
            (Shape::new(1, 40, 4, 64), 9, 3, Conv2d::new(1, 1)),
            (Shape::new(2, 6, 60, 48), 14, 5, Conv2d { groups: 2, ..Conv2d::new(1, 2) }),
            (Shape::new(1, 3, 6, 80), 8, 3, Conv2d { dilation: (2, 2), ..Conv2d::new(1, 2) }),
            (Shape::new(2, 3, 7, 64), 13, 3, Conv2d::new(2, 1)),
            (Shape::new(1, 3, 9, 160), 16, 7, Conv2d::new(2, 3)),
        ] {
            let weight = Shape::new(outputs, shape.c() / conv.groups, kernel, kernel);
            let (x, w) = (random::<f32>(1, shape, -1.0, 1.0), random::<f32>(2, weight, -1.0, 1.0));
            let b = random::<f32>(3, Shape::new(1, outputs, 1, 1), -1.0, 1.0);
            let after = After { bias: Some(b.data()), activation: Activation::Elu };
            let pool = Pool::new();
            let run = |x: &Tensor<f32>, g: Option<&Tensor<f32>>| {
                let l = Layout::new(x.shape(), weight, conv.output_shape(x.shape(), weight), &conv);
                let y = Tensor::from_vec(l.output, forward(&l, x.data(), w.data(), after, &pool));
                let mut dx = vec![f32::NAN; x.shape().len()];
                let random = random::<f32>(4, l.output, -1.0, 1.0);
                let g = g.unwrap_or(&random);
                backward_input(&l, g.data(), w.data(), &mut dx, &pool);
                (y, Tensor::from_vec(x.shape(), dx), g.clone())
            };
            let (y, dx, g) = run(&x, None);
            assert_eq!(y.shape().w() % 16, 0, "{shape}");
            let longer = wider(&x, conv.stride.1);
            let (y_longer, dx_longer, _) = run(&longer, Some(&wider(&g, 1)));
            let same = |a: &Tensor<f32>, b: &Tensor<f32>| {
                let s = a.shape();
                a.data() == Tensor::from_fn(s, |n, c, i, j| b.at(n, c, i, j)).data()
            };
            assert!(same(&y, &y_longer), "output of {shape}");
            assert!(same(&dx, &dx_longer), "gradient of {shape}");
        }
    }
}
