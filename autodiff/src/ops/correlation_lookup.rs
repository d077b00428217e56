//! Window lookup in a pyramid of correlation planes, bilinear, zero outside.
//!
//! For pixel p = (x, y) of sample n with coordinates (cx, cy), level l of L, window indices i, j in 0..=2r, D = 2r + 1:
//! y[n, l D^2 + i D + j, p] = sample of plane (n, p) of level l at (cx/2^l + i - r, cy/2^l + j - r).
//! **The slow window index i moves x.** Each of the four neighbours counts as zero outside the plane.
//! vjp: scatters g with the four weights into the pyramid; the coordinates receive nothing (they count as constants).
//! Kinks: none in the volumes, the op is linear in them.  Keeps: the coordinates, no volume.
//! Coordinates that are NaN give NaN in the whole window and pass no gradient.

use super::lookup_window::{Corner, Level, Scratch};
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin};
use crate::{Scalar, Shape, Tensor, Var, par};

/// Pixels of the first map that one block handles together, so that writes run along rows of the output.
const BLOCK: usize = 16;

/// Looks up all windows of one sample on one level; `out` holds D^2 planes of `pixels` values.
fn forward_level<T: Scalar>(level: Level, volume: &[T], coords: &[T], out: &mut [T]) {
    let (pixels, window, plane) = (coords.len() / 2, level.side() * level.side(), level.plane());
    let mut scratch = Scratch::new(&level);
    let mut values = vec![T::ZERO; window * BLOCK];
    for start in (0..pixels).step_by(BLOCK) {
        let count = BLOCK.min(pixels - start);
        for (k, values) in values.chunks_exact_mut(window).take(count).enumerate() {
            let p = start + k;
            let corner = Corner::new(coords[p], coords[pixels + p], level.level, level.radius);
            if corner.is_nan() {
                values.fill(T::from_f64(f64::NAN));
            } else {
                level.sample(&volume[p * plane..][..plane], corner, &mut scratch, values);
            }
        }
        for (channel, out) in out.chunks_exact_mut(pixels).enumerate() {
            for (k, o) in out[start..start + count].iter_mut().enumerate() {
                *o = values[k * window + channel];
            }
        }
    }
}

/// Adds the gradients of planes `first..` of one level; `g` holds the D^2 gradient planes of their sample and level.
fn backward_block<T: Scalar>(level: Level, g: &[T], coords: &[T], first: usize, planes: &mut [T]) {
    let (pixels, window, plane) = (coords.len() / 2, level.side() * level.side(), level.plane());
    let count = planes.len() / plane;
    let mut scratch = Scratch::new(&level);
    let mut values = vec![T::ZERO; window * count];
    for (channel, g) in g.chunks_exact(pixels).enumerate() {
        for (k, &g) in g[first..first + count].iter().enumerate() {
            values[k * window + channel] = g;
        }
    }
    for (k, (plane, values)) in planes.chunks_exact_mut(plane).zip(values.chunks_exact(window)).enumerate() {
        let p = first + k;
        let corner = Corner::new(coords[p], coords[pixels + p], level.level, level.radius);
        if !corner.is_nan() {
            level.scatter(values, corner, &mut scratch, plane);
        }
    }
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Windows of a correlation pyramid around given coordinates.
    ///
    /// **Formula**: channel l (2r+1)^2 + i (2r+1) + j is level l sampled at (cx/2^l + i - r, cy/2^l + j - r); the slow
    /// window index i moves x.
    /// **Shapes**: level l of the pyramid (N H W, 1, H_l, W_l), coordinates (N, 2, H, W) in pixels of level 0, channel 0 = x;
    /// result (N, L (2r+1)^2, H, W).
    /// **Gradient**: to the pyramid only.
    /// **Domain**: zero outside the planes; NaN coordinates give NaN.
    /// **Panics** when the pyramid is empty, a level has not one plane for each pixel, or `coords` has not two channels.
    #[track_caller]
    pub fn correlation_lookup(pyramid: &[Var<'t, T>], coords: Var<'t, T>, radius: usize) -> Var<'t, T> {
        let at = coords.shape();
        let shapes: Vec<Shape> = pyramid.iter().map(|v| v.shape()).collect();
        assert!(
            !pyramid.is_empty() && at.c() == 2,
            "correlation_lookup: levels {shapes:?} at coordinates {at}; the rule: at least one level, coordinates [n, 2, h, w]"
        );
        for (l, shape) in shapes.iter().enumerate() {
            assert!(
                shape.n() == at.n() * at.plane() && shape.c() == 1,
                "correlation_lookup: level {l} of shape {shape} at coordinates {at}: needs [n h w, 1, h_l, w_l]"
            );
        }
        let levels: Vec<Level> =
            shapes.iter().enumerate().map(|(level, s)| Level { height: s.h(), width: s.w(), level, radius }).collect();
        let (pixels, window) = (at.plane(), (2 * radius + 1) * (2 * radius + 1));
        let points = coords.value();
        let volumes: Vec<_> = pyramid.iter().map(|v| v.value()).collect();
        let shape = Shape::new(at.n(), levels.len() * window, at.h(), at.w());
        let mut y = coords.tape().scratch(shape.len());
        par::for_each_chunk(&mut y, (window * pixels).max(1), |i, out| {
            let (n, l) = (i / levels.len(), i % levels.len());
            let plane = levels[l].plane();
            let volume = &volumes[l].data()[n * pixels * plane..][..pixels * plane];
            forward_level(levels[l], volume, &points.data()[2 * n * pixels..][..2 * pixels], out);
        });
        let y = coords.tape().tensor(shape, y);
        coords.tape().push("correlation_lookup", y, pyramid, move |g, grads| {
            for (l, &level) in levels.iter().enumerate() {
                let Some(mut slot) = grads.slot(l) else {
                    continue;
                };
                backward_level(level, slot.as_mut_slice(), pixels, |n| {
                    let g = &g.data()[(n * levels.len() + l) * window * pixels..][..window * pixels];
                    (g, &points.data()[2 * n * pixels..][..2 * pixels])
                });
            }
        })
    }
}

/// Adds the gradient of a whole level, in blocks of planes of one sample; `operands(n)` are its gradients and coordinates.
fn backward_level<'a, T: Scalar>(
    level: Level,
    gradient: &mut [T],
    pixels: usize,
    operands: impl Fn(usize) -> (&'a [T], &'a [T]) + Sync + Send,
) {
    let plane = level.plane();
    let blocks: Vec<(usize, usize, &mut [T])> = gradient
        .chunks_mut((pixels * plane).max(1))
        .enumerate()
        .flat_map(|(n, sample)| sample.chunks_mut(4 * BLOCK * plane).enumerate().map(move |(b, out)| (n, b, out)))
        .collect();
    par::for_each_item(blocks, |_, (n, block, planes)| {
        let (g, coords) = operands(n);
        backward_block(level, g, coords, block * 4 * BLOCK, planes);
    });
}

#[derive(Clone, Copy, Debug)]
struct CorrelationLookup(usize);

impl Twin for CorrelationLookup {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        let (coords, pyramid) = v.split_first().expect("coordinates first");
        Var::correlation_lookup(pyramid, *coords, self.0)
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let (coords, pyramid, side) = (&x[0], &x[1..], 2 * self.0 + 1);
        let [samples, _, height, width] = coords.shape.0;
        Plain::from_fn(Shape::new(samples, pyramid.len() * side * side, height, width), |[n, channel, h, w]| {
            let (level, i, j) = (channel / (side * side), channel / side % side, channel % side);
            let plane = (n * height + h) * width + w;
            let scale = N::constant(0.5_f64.powi(level as i32));
            let shifted = |axis, k: usize| coords.at([n, axis, h, w]) * scale + N::constant(k as f64 - self.0 as f64);
            let (u, v) = (shifted(0, i), shifted(1, j));
            let (left, up) = (u.floor().value() as isize, v.floor().value() as isize);
            let (a, b) = (u - u.floor(), v - v.floor());
            let row = |y| {
                let at = |x| pyramid[level].or_zero(plane, 0, y, x);
                (N::one() - a) * at(left) + a * at(left + 1)
            };
            (N::one() - b) * row(up) + b * row(up + 1)
        })
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("correlation_lookup");
    let mut cases = Vec::new();
    let sizes = [
        ([1, 1, 1], vec![[1, 1]], 0),
        ([1, 2, 3], vec![[4, 5]], 1),
        ([2, 1, 3], vec![[3, 4], [2, 2]], 1),
        ([1, 3, 2], vec![[5, 3], [2, 1], [1, 1]], 2),
        ([2, 2, 2], vec![[1, 6]], 0),
        ([1, 1, 4], vec![[7, 6], [3, 3]], 3),
        ([1, 2, 2], vec![[3, 3], [2, 2]], 1),
        ([1, 5, 8], vec![[7, 8]], 1),
    ];
    for (i, ([n, h, w], levels, radius)) in sizes.into_iter().enumerate() {
        let [rows, columns] = levels[0].map(|size| size as f64);
        let (us, vs) =
            (draw.uniform(Shape::new(n, 1, h, w), -1.5, columns + 0.5), draw.uniform(Shape::new(n, 1, h, w), -1.5, rows + 0.5));
        let coords =
            Tensor::from_fn(Shape::new(n, 2, h, w), |n, c, h, w| if c == 0 { us.at(n, 0, h, w) } else { vs.at(n, 0, h, w) });
        let mut inputs = vec![coords];
        inputs.extend(levels.iter().map(|&[rows, columns]| draw.uniform(Shape::new(n * h * w, 1, rows, columns), -1.0, 1.0)));
        let case = Case::new(CorrelationLookup(radius), inputs).constant(0);
        cases.push(if i == 6 { case.constant(1) } else { case });
    }
    Proof::new("correlation_lookup", cases)
}

#[cfg(test)]
mod tests {
    use crate::gradcheck::random;
    use crate::ops::planes::testing::{noise, tensor};
    use crate::ops::testing::{check, close};
    use crate::{Shape, Tape, Tensor, Var};

    /// Value of `plane` at integer cells, zero outside.
    fn cell(volume: &Tensor<f64>, p: usize, x: f64, y: f64) -> f64 {
        let shape = volume.shape();
        let inside = x >= 0.0 && y >= 0.0 && x < shape.w() as f64 && y < shape.h() as f64;
        if inside { volume.at(p, 0, y as usize, x as usize) } else { 0.0 }
    }

    /// The lookup written out element by element.
    fn reference(pyramid: &[Tensor<f64>], coords: &Tensor<f64>, radius: usize) -> Vec<f64> {
        let (at, side) = (coords.shape(), 2 * radius + 1);
        let shape = Shape::new(at.n(), pyramid.len() * side * side, at.h(), at.w());
        let value = |n: usize, c: usize, h: usize, w: usize| {
            let (l, i, j) = (c / (side * side), c / side % side, c % side);
            let offset = |k: usize| k as f64 - radius as f64;
            let x = coords.at(n, 0, h, w) / f64::powi(2.0, l as i32) + offset(i);
            let y = coords.at(n, 1, h, w) / f64::powi(2.0, l as i32) + offset(j);
            let p = n * at.plane() + h * at.w() + w;
            let (x0, y0) = (x.floor(), y.floor());
            let row = |y: f64| (1.0 - (x - x0)) * cell(&pyramid[l], p, x0, y) + (x - x0) * cell(&pyramid[l], p, x0 + 1.0, y);
            (1.0 - (y - y0)) * row(y0) + (y - y0) * row(y0 + 1.0)
        };
        Tensor::from_fn(shape, value).to_vec()
    }

    #[test]
    fn the_slow_window_index_moves_x() {
        let tape = Tape::new();
        let plane: Vec<f64> = (0..25).map(f64::from).collect();
        let volume = tape.constant(tensor([1, 1, 5, 5], &plane));
        let coords = tape.constant(tensor([1, 2, 1, 1], &[2.0, 1.0]));
        // Centre 7; x - 1 comes first, with y running fastest: 1 6 11 | 2 7 12 | 3 8 13.
        let y = Var::correlation_lookup(&[volume], coords, 1);
        close(y.value().data(), &[1.0, 6.0, 11.0, 2.0, 7.0, 12.0, 3.0, 8.0, 13.0]);
    }

    #[test]
    fn outside_reads_zero_and_halves_fade() {
        let tape = Tape::new();
        let volume = tape.leaf(tensor([1, 1, 1, 2], &[4.0, 8.0]));
        let coords = tape.constant(tensor([1, 2, 1, 1], &[-0.5, 0.25]));
        let y = Var::correlation_lookup(&[volume], coords, 1);
        // x at -1.5, -0.5, 0.5 gives 0, 2, 6; y at -0.75, 0.25, 1.25 keeps 0.25, 0.75, 0 of it.
        close(y.value().data(), &[0.0, 0.0, 0.0, 0.5, 1.5, 0.0, 1.5, 4.5, 0.0]);
        close(tape.backward(y.sum()).wrt(volume).data(), &[1.0, 0.5]);
    }

    #[test]
    fn agrees_with_the_written_out_formula_on_a_pyramid() {
        let (n, h, w, radius) = (2, 5, 7, 2);
        let tape = Tape::new();
        let sizes = [(5, 7), (2, 3), (1, 1)];
        let pyramid: Vec<_> = sizes.iter().map(|&(a, b)| noise(a as u64, [n * h * w, 1, a, b])).collect();
        let coords = random(4, Shape::new(n, 2, h, w), -6.0, 12.0);
        let vars: Vec<_> = pyramid.iter().map(|v| tape.constant(v.clone())).collect();
        let y = Var::correlation_lookup(&vars, tape.constant(coords.clone()), radius);
        close(y.value().data(), &reference(&pyramid, &coords, radius));
    }

    #[test]
    fn gradient_reaches_every_level() {
        let coords = random(4, Shape::new(2, 2, 1, 2), -1.0, 4.0);
        let inputs = [noise(1, [4, 1, 3, 4]), noise(2, [4, 1, 1, 2])];
        check(&inputs, |v| Var::correlation_lookup(v, v[0].tape().constant(coords.clone()), 1).square());
    }

    #[test]
    fn linear_with_the_right_transpose() {
        let (tape, coords) = (Tape::new(), random(4, Shape::new(1, 2, 9, 8), -3.0, 9.0));
        let volume = tape.leaf(noise(1, [72, 1, 6, 5]));
        let y = Var::correlation_lookup(&[volume], tape.constant(coords), 3);
        let g = noise(2, y.shape().0);
        let pulled = tape.backward(y.mul(tape.constant(g.clone())).sum()).wrt(volume);
        let dot = |a: &Tensor<f64>, b: &Tensor<f64>| a.data().iter().zip(b.data()).map(|(a, b)| a * b).sum::<f64>();
        close(&[dot(&pulled, &volume.value())], &[dot(&y.value(), &g)]);
    }

    #[test]
    fn coordinates_get_no_gradient_and_bad_ones_do_no_harm() {
        let tape = Tape::new();
        let volume = tape.leaf(noise(1, [3, 1, 2, 2]));
        let coords = tape.leaf(tensor([1, 2, 1, 3], &[f64::NAN, f64::INFINITY, -1e300, 0.0, 0.0, 1.0]));
        let y = Var::correlation_lookup(&[volume], coords, 1);
        assert!((0..9).all(|c| y.value().at(0, c, 0, 0).is_nan() && y.value().at(0, c, 0, 1) == 0.0));
        let grads = tape.backward(y.sum());
        assert!(grads.get(coords).is_none());
        close(grads.wrt(volume).data(), &[0.0; 12]);
    }

    #[test]
    #[should_panic(expected = "correlation_lookup: level 0 of shape [5, 1, 2, 2] at coordinates [1, 2, 2, 2]")]
    fn rejects_a_wrong_number_of_planes() {
        let tape = Tape::new();
        Var::correlation_lookup(&[tape.constant(noise(1, [5, 1, 2, 2]))], tape.constant(noise(1, [1, 2, 2, 2])), 1);
    }
}
