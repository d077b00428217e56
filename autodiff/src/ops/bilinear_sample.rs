//! Bilinear sampling of an image at pixel coordinates, differentiable in both arguments.
//!
//! For a pixel (u, v), u to the right and v down, pixel centres at integers, i = floor(u), j = floor(v), a = u - i, b = v - j:
//! y = (1-b) [(1-a) I(i, j) + a I(i+1, j)] + b [(1-a) I(i, j+1) + a I(i+1, j+1)].
//! Outside the image: `Border` clamps u to [0, W-1] and v to [0, H-1] first; `Zeros` reads 0.
//! vjp: the image receives g times the four weights; u receives sum over channels of
//! g [(1-b) (I(i+1, j) - I(i, j)) + b (I(i+1, j+1) - I(i, j+1))], v likewise.
//! Kinks: at integer coordinates the derivative of the cell to the right (below) is taken; where the clamp of `Border` is
//! active, u <= 0 or u >= W-1, the derivative by u is 0, and likewise for v.
//! A coordinate that is NaN gives NaN in every channel and passes no gradient; infinite ones lie outside like any other.
//! Where the incoming gradient is 0 the coordinates get none, whatever the image holds there.
//! Keeps: both arguments; the weights are computed again in the backward pass.

use super::sample_axis::AxisTap;
pub use super::sample_axis::SamplePadding;
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin};
use crate::{Scalar, Shape, Tensor, Var, par};

/// Weights of one sample on the four pixels of the 2 x 2 cell that starts at `base`.
#[derive(Clone, Copy, Debug)]
struct Tap<T> {
    base: usize,
    weights: [T; 4],
}

/// Derivatives of the weights of one sample by its coordinates.
#[derive(Clone, Copy, Debug)]
struct SlopeTap<T> {
    base: usize,
    by_u: [T; 4],
    by_v: [T; 4],
}

/// The outer product of weights along v and along u, in the order of a cell.
#[inline(always)]
fn outer<T: Scalar>(v: [T; 2], u: [T; 2]) -> [T; 4] {
    [v[0] * u[0], v[0] * u[1], v[1] * u[0], v[1] * u[1]]
}

#[inline(always)]
fn dot<T: Scalar>(weights: &[T; 4], cell: [T; 4]) -> T {
    (weights[0] * cell[0] + weights[1] * cell[1]) + (weights[2] * cell[2] + weights[3] * cell[3])
}

/// Image size, distances to the right and lower neighbour (0 along an axis of one pixel) and the rule at the border.
#[derive(Clone, Copy, Debug)]
struct Sampler {
    image: Shape,
    out: Shape,
    right: usize,
    below: usize,
    padding: SamplePadding,
}

impl Sampler {
    fn new(image: Shape, coords: Shape, padding: SamplePadding) -> Self {
        let right = usize::from(image.w() > 1);
        let below = if image.h() > 1 { image.w() } else { 0 };
        let out = image.with_plane(coords.h(), coords.w());
        Self { image, out, right, below, padding }
    }

    /// Calls `f(start, taps)` for every row of one sample's coordinate planes. `start` is the flat index of the row's first
    /// pixel; `make(base, u, v)` turns the weights along both axes into what `f` needs of each sample.
    #[inline(always)]
    fn for_each_row<T: Scalar, P>(
        &self,
        coords: &[T],
        make: impl Fn(usize, AxisTap<T>, AxisTap<T>) -> P,
        mut f: impl FnMut(usize, &[P]),
    ) {
        let (us, vs) = coords.split_at(self.out.plane());
        let width = self.out.w().max(1);
        let mut taps = Vec::with_capacity(width);
        let rows = us.chunks_exact(width).zip(vs.chunks_exact(width));
        for (row, (us, vs)) in rows.enumerate() {
            taps.clear();
            taps.extend(us.iter().zip(vs).map(|(&u, &v)| {
                let u = AxisTap::at(u, self.image.w(), self.padding);
                let v = AxisTap::at(v, self.image.h(), self.padding);
                make(v.base * self.image.w() + u.base, u, v)
            }));
            f(row * width, &taps);
        }
    }

    /// The four pixels of a cell: upper left and right, lower left and right.
    #[inline(always)]
    fn cell<T: Scalar>(&self, plane: &[T], base: usize) -> [T; 4] {
        let cell = &plane[base..base + self.below + self.right + 1];
        [cell[0], cell[self.right], cell[self.below], cell[self.below + self.right]]
    }

    fn forward<T: Scalar>(&self, image: &[T], coords: &[T], out: &mut [T]) {
        let (plane, out_plane) = (self.image.plane(), self.out.plane());
        let make = |base, u: AxisTap<T>, v: AxisTap<T>| Tap { base, weights: outer(v.weight, u.weight) };
        self.for_each_row(coords, make, |start, taps| {
            let planes = image.chunks_exact(plane).zip(out.chunks_exact_mut(out_plane));
            for (pixels, out) in planes {
                for (o, tap) in out[start..].iter_mut().zip(taps) {
                    *o = dot(&tap.weights, self.cell(pixels, tap.base));
                }
            }
        });
    }

    /// Scatters `g` with the weights of the samples onto the planes of one image.
    fn backward_image<T: Scalar>(&self, g: &[T], coords: &[T], gradient: &mut [T]) {
        let (plane, out_plane) = (self.image.plane(), self.out.plane().max(1));
        let (right, below) = (self.right, self.below);
        let make = |base, u: AxisTap<T>, v: AxisTap<T>| {
            let bad = u.is_nan() || v.is_nan();
            Tap { base, weights: if bad { [T::ZERO; 4] } else { outer(v.weight, u.weight) } }
        };
        gradient.fill(T::ZERO);
        self.for_each_row(coords, make, |start, taps| {
            let planes = gradient.chunks_exact_mut(plane).zip(g.chunks_exact(out_plane));
            for (pixels, g) in planes {
                for (&g, tap) in g[start..].iter().zip(taps) {
                    let cell = &mut pixels[tap.base..tap.base + below + right + 1];
                    cell[0] += tap.weights[0] * g;
                    cell[right] += tap.weights[1] * g;
                    cell[below] += tap.weights[2] * g;
                    cell[below + right] += tap.weights[3] * g;
                }
            }
        });
    }

    /// Sums over the channels the derivative by both coordinates of one sample.
    fn backward_coords<T: Scalar>(&self, g: &[T], image: &[T], coords: &[T], gradient: &mut [T]) {
        let (plane, out_plane) = (self.image.plane(), self.out.plane());
        let make = |base, u: AxisTap<T>, v: AxisTap<T>| {
            if u.is_nan() || v.is_nan() {
                SlopeTap { base, by_u: [T::ZERO; 4], by_v: [T::ZERO; 4] }
            } else {
                SlopeTap { base, by_u: outer(v.weight, u.slope), by_v: outer(v.slope, u.weight) }
            }
        };
        gradient.fill(T::ZERO);
        let (along_u, along_v) = gradient.split_at_mut(out_plane);
        self.for_each_row(coords, make, |start, taps| {
            for (pixels, g) in image.chunks_exact(plane).zip(g.chunks_exact(out_plane)) {
                let along = along_u[start..].iter_mut().zip(&mut along_v[start..]);
                for (((gu, gv), &g), tap) in along.zip(&g[start..]).zip(taps) {
                    // A reading that no one uses may be infinite.
                    if g == T::ZERO {
                        continue;
                    }
                    let cell = self.cell(pixels, tap.base);
                    *gu += g * dot(&tap.by_u, cell);
                    *gv += g * dot(&tap.by_v, cell);
                }
            }
        });
    }
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Samples this image at the pixel coordinates `coords`.
    ///
    /// **Shapes**: image (N, C, H, W), coordinates (N, 2, H', W'), channel 0 = u (column), 1 = v (row); result (N, C, H', W').
    /// **Units**: pixels, centre of the first pixel at (0, 0). Equals PyTorch's `grid_sample(align_corners=True)` on the
    /// coordinates normalised by (size - 1)/2.
    /// **Gradient**: to the image and to the coordinates; the latter 0 where the clamp of `Border` is active.
    /// **Domain**: NaN coordinates give NaN and pass no gradient.
    /// **Panics** when the numbers of samples differ or `coords` has not two channels.
    #[track_caller]
    pub fn bilinear_sample(self, coords: Var<'t, T>, padding: SamplePadding) -> Var<'t, T> {
        let (shape, coords_shape) = (self.shape(), coords.shape());
        assert!(
            shape.n() == coords_shape.n() && coords_shape.c() == 2,
            "bilinear_sample: image {shape} at coordinates {coords_shape}: needs [n, c, h, w] and [n, 2, h', w']"
        );
        let sampler = Sampler::new(shape, coords_shape, padding);
        let (image_len, coords_len) = (shape.c() * shape.plane(), 2 * coords_shape.plane());
        let out_len = shape.c() * coords_shape.plane();
        let (image, points) = (self.value(), coords.value());
        let mut y = self.tape().scratch(sampler.out.len());
        par::for_each_chunk(&mut y, out_len.max(1), |n, out| {
            sampler.forward(&image.data()[n * image_len..][..image_len], &points.data()[n * coords_len..][..coords_len], out);
        });
        let y = self.tape().tensor(sampler.out, y);
        self.tape().push("bilinear_sample", y, &[self, coords], move |g, grads| {
            let point = |n: usize| &points.data()[n * coords_len..][..coords_len];
            let g = |n: usize| &g.data()[n * out_len..][..out_len];
            if let Some(mut slot) = grads.slot(0) {
                slot.write(|out| {
                    par::for_each_chunk(out, image_len.max(1), |n, out| sampler.backward_image(g(n), point(n), out));
                });
            }
            if let Some(mut slot) = grads.slot(1) {
                let image = |n: usize| &image.data()[n * image_len..][..image_len];
                slot.write(|out| {
                    par::for_each_chunk(out, coords_len.max(1), |n, out| {
                        sampler.backward_coords(g(n), image(n), point(n), out);
                    });
                });
            }
        })
    }
}

#[derive(Clone, Copy, Debug)]
struct Sample(SamplePadding);

impl Twin for Sample {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].bilinear_sample(v[1], self.0)
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let (image, coords) = (&x[0], &x[1]);
        let [_, channels, height, width] = image.shape.0;
        let out = Shape::new(image.shape.n(), channels, coords.shape.h(), coords.shape.w());
        let held = |x: N, size: usize| match self.0 {
            SamplePadding::Border => x.max(N::zero()).min(N::constant(size as f64 - 1.0)),
            SamplePadding::Zeros => x,
        };
        Plain::from_fn(out, |[n, c, h, w]| {
            let (u, v) = (held(coords.at([n, 0, h, w]), width), held(coords.at([n, 1, h, w]), height));
            let (i, j) = (u.value().floor() as isize, v.value().floor() as isize);
            let (a, b) = (u - u.floor(), v - v.floor());
            let row = |j| (N::one() - a) * image.or_zero(n, c, j, i) + a * image.or_zero(n, c, j, i + 1);
            (N::one() - b) * row(j) + b * row(j + 1)
        })
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("bilinear_sample");
    let mut cases = Vec::new();
    let sizes = [
        ([2, 3, 3, 5], [4, 3], [true, true]),
        ([1, 1, 1, 4], [5, 2], [true, true]),
        ([1, 2, 6, 1], [3, 7], [true, true]),
        ([2, 1, 1, 1], [2, 3], [true, true]),
        ([1, 2, 2, 2], [1, 1], [true, true]),
        ([2, 2, 7, 4], [1, 9], [true, false]),
        ([2, 4, 4, 7], [9, 1], [false, true]),
        ([2, 3, 11, 31], [5, 6], [true, true]),
        ([1, 2, 5, 6], [29, 35], [true, true]),
    ];
    for (image, [h, w], moves) in sizes {
        for padding in [SamplePadding::Border, SamplePadding::Zeros] {
            let values = draw.uniform(Shape(image), -1.0, 1.0);
            let points = around(&mut draw, Shape::new(image[0], 2, h, w), image[3], image[2]);
            let mut case = Case::new(Sample(padding), [values, points]);
            for k in (0..2).filter(|&k| !moves[k]) {
                case = case.constant(k);
            }
            cases.push(case);
        }
    }
    Proof::new("bilinear_sample", cases)
}

/// Coordinates in an image and up to two pixels beyond, at least 0.05 away from every integer.
fn around(draw: &mut Draw, shape: Shape, width: usize, height: usize) -> Tensor<f64> {
    let (whole, part) = (draw.uniform(shape, 0.0, 1.0), draw.uniform(shape, 0.05, 0.95));
    Tensor::from_fn(shape, |n, c, h, w| {
        let cells = if c == 0 { width + 3 } else { height + 3 };
        (whole.at(n, c, h, w) * cells as f64).floor() - 2.0 + part.at(n, c, h, w)
    })
}

#[cfg(test)]
mod tests {
    use super::SamplePadding::{self, Border, Zeros};
    use crate::gradcheck::random;
    use crate::ops::planes::testing::{noise, tensor};
    use crate::ops::testing::{check, check_adjoint, close};
    use crate::{Shape, Tape, Tensor};

    const IMAGE: [f64; 6] = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0];

    fn at(points: &[(f64, f64)], padding: SamplePadding) -> (Vec<f64>, Vec<f64>, Vec<f64>) {
        let tape = Tape::new();
        let image = tape.leaf(tensor([1, 1, 2, 3], &IMAGE));
        let flat: Vec<f64> = points.iter().map(|p| p.0).chain(points.iter().map(|p| p.1)).collect();
        let coords = tape.leaf(tensor([1, 2, 1, points.len()], &flat));
        let y = image.bilinear_sample(coords, padding);
        let grads = tape.backward(y.sum());
        (y.value().to_vec(), grads.wrt(image).to_vec(), grads.wrt(coords).to_vec())
    }

    #[test]
    fn worked_sample_inside() {
        for padding in [Border, Zeros] {
            let (value, image, coords) = at(&[(1.25, 0.5)], padding);
            // Rows at u = 1.25: 2.5 and 20; between them 11.25. Slopes: (2 + 16)/2 and 20 - 2.5.
            close(&value, &[11.25]);
            close(&image, &[0.0, 0.375, 0.125, 0.0, 0.375, 0.125]);
            close(&coords, &[9.0, 17.5]);
        }
    }

    #[test]
    fn readings_that_no_one_uses_may_be_anything() {
        let tape = Tape::new();
        let image = tape.leaf(tensor([1, 1, 2, 3], &[1.0, 2.0, f64::NAN, 8.0, 16.0, f64::INFINITY]));
        let coords = tape.leaf(tensor([1, 2, 1, 2], &[0.25, 1.5, 0.5, 0.5]));
        let y = image.bilinear_sample(coords, Border).slice(3, 0, 1);
        let grads = tape.backward(y.sum());
        close(&y.value().to_vec(), &[0.5 * 1.25 + 0.5 * 10.0]);
        close(&grads.wrt(coords).to_vec(), &[4.5, 0.0, 8.75, 0.0]);
        close(&grads.wrt(image).to_vec(), &[0.375, 0.125, 0.0, 0.375, 0.125, 0.0]);
    }

    #[test]
    fn border_clamps_and_stops_the_gradient_there() {
        let (value, image, coords) = at(&[(-0.5, 0.25), (2.75, 0.25), (0.5, 1.0), (0.5, 9.0)], Border);
        close(&value, &[2.75, 11.0, 12.0, 12.0]);
        close(&image, &[0.75, 0.0, 0.75, 1.25, 1.0, 0.25]);
        close(&coords, &[0.0, 0.0, 8.0, 8.0, 7.0, 28.0, 0.0, 0.0]);
    }

    #[test]
    fn zeros_fade_out_over_one_pixel() {
        let (value, image, coords) = at(&[(-0.5, 0.0), (2.75, 1.0), (1.0, -1.5), (0.0, 1.5)], Zeros);
        close(&value, &[0.5, 8.0, 0.0, 4.0]);
        close(&image, &[0.5, 0.0, 0.0, 0.5, 0.0, 0.25]);
        // Slopes by u: 1 on the left, -32 on the right, 0 outside, (16 - 8)/2; by v: (8 - 1)/2, -8, 0, -8.
        close(&coords, &[1.0, -32.0, 0.0, 4.0, 3.5, -8.0, 0.0, -8.0]);
    }

    #[test]
    fn integer_coordinates_return_the_pixels() {
        let tape = Tape::new();
        let x = noise(1, [2, 3, 4, 5]);
        let grid = Tensor::from_fn(Shape::new(2, 2, 4, 5), |_, c, h, w| if c == 0 { w as f64 } else { h as f64 });
        for padding in [Border, Zeros] {
            let y = tape.constant(x.clone()).bilinear_sample(tape.constant(grid.clone()), padding);
            assert_eq!(y.value().data(), x.data());
        }
    }

    #[test]
    fn images_of_one_pixel_are_constant_inside_the_border() {
        let tape = Tape::new();
        let image = tape.leaf(tensor([1, 2, 1, 1], &[3.0, 5.0]));
        let coords = tape.leaf(tensor([1, 2, 1, 2], &[0.3, -0.25, -0.4, 0.0]));
        let y = image.bilinear_sample(coords, Border);
        close(y.value().data(), &[3.0, 3.0, 5.0, 5.0]);
        close(tape.backward(y.sum()).wrt(coords).data(), &[0.0; 4]);
        let y = image.bilinear_sample(coords, Zeros);
        close(y.value().data(), &[3.0 * 0.42, 3.0 * 0.75, 5.0 * 0.42, 5.0 * 0.75]);
    }

    #[test]
    fn not_a_number_shows_in_the_value_and_stays_out_of_the_gradients() {
        for padding in [Border, Zeros] {
            let (value, image, coords) = at(&[(f64::NAN, 0.5), (1.0, f64::NAN), (f64::INFINITY, 0.5), (1.25, 0.5)], padding);
            assert!(value[0].is_nan() && value[1].is_nan() && value[2].is_finite());
            assert!(image.iter().chain(&coords).all(|v| v.is_finite()));
            assert_eq!((coords[0], coords[1], coords[4], coords[5]), (0.0, 0.0, 0.0, 0.0));
        }
    }

    /// Coordinates around the image, at least 0.05 away from every integer.
    fn points(seed: u64, shape: Shape, width: usize, height: usize) -> Tensor<f64> {
        let whole: Tensor<f64> = random(seed, shape, 0.0, 1.0);
        let part: Tensor<f64> = random(seed + 1, shape, 0.05, 0.95);
        Tensor::from_fn(shape, |n, c, h, w| {
            let cells = if c == 0 { width + 3 } else { height + 3 };
            (whole.at(n, c, h, w) * cells as f64).floor() - 2.0 + part.at(n, c, h, w)
        })
    }

    #[test]
    fn gradient_matches_finite_differences() {
        for (sizes, (h, w)) in [([2, 2, 3, 5], (4, 3)), ([1, 1, 1, 4], (5, 2)), ([1, 3, 6, 1], (3, 7))] {
            let image = noise(3, sizes);
            let coords = points(5, Shape::new(sizes[0], 2, h, w), sizes[3], sizes[2]);
            for padding in [Border, Zeros] {
                check(&[image.clone(), coords.clone()], |v| v[0].bilinear_sample(v[1], padding));
            }
        }
    }

    #[test]
    fn linear_in_the_image() {
        let coords = points(7, Shape::new(2, 2, 6, 5), 4, 3);
        for padding in [Border, Zeros] {
            check_adjoint(Shape::new(2, 3, 3, 4), 8, |x| x.bilinear_sample(x.tape().constant(coords.clone()), padding));
        }
    }

    #[test]
    #[should_panic(expected = "bilinear_sample: image [2, 1, 3, 3] at coordinates [1, 2, 3, 3]")]
    fn rejects_another_number_of_samples() {
        let tape = Tape::new();
        tape.constant(noise(1, [2, 1, 3, 3])).bilinear_sample(tape.constant(noise(1, [1, 2, 3, 3])), Border);
    }

    #[test]
    #[should_panic(expected = "at coordinates [2, 3, 3, 3]")]
    fn rejects_coordinates_of_three_channels() {
        let tape = Tape::new();
        tape.constant(noise(1, [2, 1, 3, 3])).bilinear_sample(tape.constant(noise(1, [2, 3, 3, 3])), Border);
    }
}
