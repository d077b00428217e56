//! Photometric error of a warped image: structural dissimilarity and absolute difference (paper, eq. `photometric_loss`).
//!
//! `e(p) = alpha mean_c (1 - SSIM_c(p)) / 2 + (1 - alpha) mean_c |target_c(p) - warped_c(p)|`, alpha = 0.85, SSIM over 3 x 3
//! means with mirrored borders, `C1 = 0.01^2`, `C2 = 0.03^2`; the first factor is clamped to [0, 1].
//!
//! One fused operation. Window sums are taken of colours minus 0.5, which changes neither variances nor covariances but keeps
//! four times more digits of them in `f32`.
//!
//! vjp, per channel, with `S = a1 a2 / (b1 b2)` and box means `m`: the partial derivatives of `S` by `m_x`, `m_xx` and `m_xy` times
//! the incoming gradient go back through the transposed box filter. At the clamp and at equal colours the subgradient is 0.

use std::ops::Range;

use dimode_autodiff::simd::Wide;
use dimode_autodiff::{Pool, Scalar, Tensor, Var, par};
use pulp::{Arch, Simd, WithSimd};

use super::rows::{PAD, RING, band_rows, clear_sides, cut, get, number, put, row, row_mut, rows_mut, stride};
use super::similarity::{Colours, Sums, Weights, add_row_pairs, add_rows, error_row, neighbours, spread_row};

/// Weight of the dissimilarity.
pub const ALPHA: f64 = 0.85;
/// Keeps the quotient of means away from 0 / 0.
pub const C1: f64 = 0.01 * 0.01;
/// Keeps the quotient of variances away from 0 / 0.
pub const C2: f64 = 0.03 * 0.03;
/// Colours are moved by this much before sums are taken.
pub const SHIFT: f64 = 0.5;

/// Error map `[n, 1, h, w]` of `warped` against `target`, both `[n, c, h, w]` with colours in [0, 1].
///
/// # Panics
/// When the shapes differ or a side is shorter than 2 pixels.
#[track_caller]
pub fn photometric<'t, T: Scalar>(warped: Var<'t, T>, target: Var<'t, T>) -> Var<'t, T> {
    let (x, y) = (warped.value(), target.value());
    let shape = x.shape();
    assert!(shape == y.shape(), "photometric: images must have equal shapes, got {shape} and {}", y.shape());
    assert!(shape.h() >= 2 && shape.w() >= 2, "photometric: mirrored borders need at least 2 x 2 pixels, got {shape}");
    let tape = warped.tape();
    let mut out = tape.scratch(shape.n() * shape.plane());
    let (h, w, channels) = (shape.h(), shape.w(), shape.c());
    let pool = tape.pool();
    par::for_each_item(bands(&mut out, h, w), |_, (n, rows, out)| {
        let mut work = pool.take(stride(w) * (2 * RING * channels + 6));
        let size = Size { h, w, channels };
        Arch::new().dispatch(Errors { x: &x, y: &y, n, size, rows, work: &mut work, out });
        pool.give(work);
    });
    let output = tape.tensor(shape.with_c(1), out);
    let pool = pool.clone();
    tape.push("photometric", output, &[warped, target], move |g, grads| {
        for (slot, [x, y]) in [[&x, &y], [&y, &x]].into_iter().enumerate() {
            if let Some(mut slot) = grads.slot(slot) {
                slot.write(|dx| backward([x, y, g], &pool, dx));
            }
        }
    })
}

/// Absolute difference of images `[n, c, h, w]`, mean over channels, `[n, 1, h, w]`: the second part of the error.
///
/// # Panics
/// When the shapes differ.
#[track_caller]
pub fn absolute_difference<'t, T: Scalar>(x: Var<'t, T>, y: Var<'t, T>) -> Var<'t, T> {
    x.sub(y).abs().mean_channels()
}

/// Error map of plain tensors, without gradient.
pub fn photometric_value<T: Scalar>(warped: &Tensor<T>, target: &Tensor<T>) -> Tensor<T> {
    let tape = dimode_autodiff::Tape::new();
    photometric(tape.constant(warped.clone()), tape.constant(target.clone())).value()
}

/// The gradient with respect to `x` of an error with gradient `g`; the operation is symmetric in its images.
fn backward<T: Scalar>([x, y, g]: [&Tensor<T>; 3], pool: &Pool<T>, dx: &mut [T]) {
    let shape = x.shape();
    let size = Size { h: shape.h(), w: shape.w(), channels: shape.c() };
    par::for_each_item(bands(dx, size.h, size.w), |_, (plane, rows, dx)| {
        let (n, c) = (plane / size.channels, plane % size.channels);
        let mut work = pool.take(stride(size.w) * (6 * RING + 9));
        let planes = [x.plane(n, c), y.plane(n, c), g.plane(n, 0)];
        Arch::new().dispatch(Slopes { planes, size, rows, work: &mut work, dx });
        pool.give(work);
    });
}

/// Bands of all planes of a buffer: plane, rows, elements.
fn bands<T>(data: &mut [T], h: usize, w: usize) -> Vec<(usize, Range<usize>, &mut [T])> {
    let band = band_rows(h);
    let mut out = Vec::with_capacity(data.len() / (h * w) * h.div_ceil(band));
    for (i, plane) in data.chunks_mut(h * w).enumerate() {
        let rows = (0..h).step_by(band).map(|first| first..(first + band).min(h));
        out.extend(rows.zip(plane.chunks_mut(band * w)).map(|(rows, band)| (i, rows, band)));
    }
    out
}

#[derive(Clone, Copy)]
struct Size {
    h: usize,
    w: usize,
    channels: usize,
}

/// Copies an image row to a scratch row, moved by `-SHIFT`.
#[inline(always)]
fn shifted<S: Simd, T: Scalar>(simd: S, from: &[T], to: &mut [T]) {
    let shift = number(simd, SHIFT);
    for j in (0..from.len()).step_by(Wide::<S, T>::lanes()) {
        (get(simd, from, j) - shift).store(&mut to[PAD + j..]);
    }
}

/// The errors of a band.
struct Errors<'a, T: Scalar> {
    x: &'a Tensor<T>,
    y: &'a Tensor<T>,
    n: usize,
    size: Size,
    rows: Range<usize>,
    work: &'a mut [T],
    out: &'a mut [T],
}

impl<T: Scalar> WithSimd for Errors<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Size { h, w, channels } = self.size;
        let stride = stride(w);
        let mut rest = self.work;
        let [xs, ys] = [(); 2].map(|()| cut(&mut rest, RING * channels * stride));
        let [sy, syy, sx, sxx, sxy, error] = rows_mut(rest, 0, stride);
        let Range { start, end } = self.rows;
        for r in start.saturating_sub(1)..(end + 1).min(h) {
            for c in 0..channels {
                shifted(simd, &self.x.plane(self.n, c)[r * w..][..w], row_mut(xs, r % RING * channels + c, stride));
                shifted(simd, &self.y.plane(self.n, c)[r * w..][..w], row_mut(ys, r % RING * channels + c, stride));
            }
            // The last row of the image has no row below that it must wait for.
            for q in (r.saturating_sub(1)..if r + 1 == h { h } else { r }).filter(|q| (start..end).contains(q)) {
                let [above, below] = neighbours(q, h);
                for c in 0..channels {
                    let x = [above, q, below].map(|i| row(xs, i % RING * channels + c, stride));
                    let y = [above, q, below].map(|i| row(ys, i % RING * channels + c, stride));
                    add_rows(simd, y, w, [sy, syy]);
                    add_row_pairs(simd, (x, y), w, [sx, sxx, sxy]);
                    let sums = Sums { x: sx, y: sy, xx: sxx, yy: syy, xy: sxy };
                    error_row(simd, &sums, [x[1], y[1]], (w, channels, c == 0), error, None);
                }
                let out = &mut self.out[(q - start) * w..][..w];
                for j in (0..w).step_by(Wide::<S, T>::lanes()) {
                    put(Wide::load(simd, &error[PAD + j..]), out, j);
                }
            }
        }
    }
}

/// The gradient of the colours of one channel in a band.
struct Slopes<'a, T: Scalar> {
    /// The image, the other image, the gradient of the error.
    planes: [&'a [T]; 3],
    size: Size,
    rows: Range<usize>,
    work: &'a mut [T],
    dx: &'a mut [T],
}

impl<T: Scalar> WithSimd for Slopes<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Size { h, w, channels } = self.size;
        let stride = stride(w);
        let mut rest = self.work;
        let [xs, ys, gs] = [(); 3].map(|()| cut(&mut rest, RING * stride));
        let spread = cut(&mut rest, 3 * RING * stride);
        let [sy, syy, sx, sxx, sxy, error, by_x, by_xx, by_xy] = rows_mut(rest, 0, stride);
        // Windows read one column beyond either end, with weight 0.
        let whole = w.next_multiple_of(Wide::<S, T>::lanes());
        clear_sides(by_x, whole);
        clear_sides(by_xx, whole);
        clear_sides(by_xy, whole);
        gs.chunks_exact_mut(stride).for_each(|row| clear_sides(row, w));
        let Range { start, end } = self.rows;
        let errors = start.saturating_sub(1)..(end + 1).min(h);
        for r in errors.start.saturating_sub(1)..(errors.end + 1).min(h) {
            shifted(simd, &self.planes[0][r * w..][..w], row_mut(xs, r % RING, stride));
            shifted(simd, &self.planes[1][r * w..][..w], row_mut(ys, r % RING, stride));
            row_mut(gs, r % RING, stride)[PAD..PAD + w].copy_from_slice(&self.planes[2][r * w..][..w]);
            // The last row of the image has no row below that it must wait for.
            for q in (r.saturating_sub(1)..if r + 1 == h { h } else { r }).filter(|q| errors.contains(q)) {
                let [above, below] = neighbours(q, h);
                let x = [above, q, below].map(|i| row(xs, i % RING, stride));
                let y = [above, q, below].map(|i| row(ys, i % RING, stride));
                add_rows(simd, y, w, [sy, syy]);
                add_row_pairs(simd, (x, y), w, [sx, sxx, sxy]);
                let sums = Sums { x: sx, y: sy, xx: sxx, yy: syy, xy: sxy };
                let partial = Some([&mut *by_x, &mut *by_xx, &mut *by_xy]);
                error_row(simd, &sums, [x[1], y[1]], (w, channels, true), error, partial);
                let g = row(gs, q % RING, stride);
                for (i, partial) in [&*by_x, by_xx, by_xy].into_iter().enumerate() {
                    spread_row(simd, [partial, g], w, row_mut(spread, q % RING * 3 + i, stride));
                }
                for p in (q.saturating_sub(1)..if q + 1 == h { h } else { q }).filter(|p| (start..end).contains(p)) {
                    // A row that is not there has the weight 0.
                    let window = [p.saturating_sub(1), p, (p + 1).min(h - 1)];
                    let colours = Colours {
                        by_x: window.map(|r| row(spread, r % RING * 3, stride)),
                        by_xx: window.map(|r| row(spread, r % RING * 3 + 1, stride)),
                        by_xy: window.map(|r| row(spread, r % RING * 3 + 2, stride)),
                        x: row(xs, p % RING, stride),
                        y: row(ys, p % RING, stride),
                    };
                    let weights = Weights::new(simd, p, h, channels);
                    let g = row(gs, p % RING, stride);
                    let out = &mut self.dx[(p - start) * w..][..w];
                    for j in (0..w).step_by(Wide::<S, T>::lanes()) {
                        put(colours.gradient_of_used(simd, PAD + j, weights, Wide::load(simd, &g[PAD + j..])), out, j);
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::gradcheck::{random, weighted_sum};
    use dimode_autodiff::{GradCheck, Shape, Tape, gradcheck};

    /// The window of 3x3 colours around an inner pixel of a channel.
    fn window(image: &Tensor<f64>, c: usize, [v, u]: [usize; 2]) -> Vec<f64> {
        (0..9).map(|i| image.at(0, c, v + i / 3 - 1, u + i % 3 - 1)).collect()
    }

    #[test]
    fn inner_pixels_have_the_error_and_the_gradient_of_the_closed_form() {
        use crate::photometric::{ALPHA, C1, C2, Moments, channel_error_gradient, photometric_error};
        let shape = Shape::new(1, 3, 5, 7);
        let images = [1, 2].map(|seed| random::<f64>(seed, shape, 0.0, 1.0));
        let tape = Tape::new();
        let warped = tape.leaf(images[0].clone());
        let error = photometric(warped, tape.constant(images[1].clone()));
        for (v, u) in (1..4).flat_map(|v| (1..6).map(move |u| (v, u))) {
            let pairs = [0, 1, 2].map(|c| [&images[0], &images[1]].map(|image| window(image, c, [v, u])));
            let similarities = pairs.each_ref().map(|[x, y]| Moments::of(x, y).similarity(C1, C2));
            let differences = pairs.each_ref().map(|[x, y]| x[4] - y[4]);
            let expected = photometric_error(&similarities, &differences, ALPHA);
            assert!((error.value().at(0, 0, v, u) - expected).abs() < 1e-12, "value at ({v}, {u})");
            let picked = Tensor::from_fn(error.shape(), |_, _, y, x| f64::from(u8::from((y, x) == (v, u))));
            let gradients = tape.backward(error.mul(tape.constant(picked)).sum());
            for (c, [x, y]) in pairs.iter().enumerate() {
                let closed = channel_error_gradient(x, y, 4, ALPHA);
                let found = window(&gradients.wrt(warped), c, [v, u]);
                // The channels share the error.
                let off = closed.iter().zip(&found).map(|(a, b)| (a / 3.0 - b).abs()).fold(0.0, f64::max);
                assert!(off < 1e-10, "gradient at ({v}, {u}), channel {c}: {off:e}");
            }
        }
    }

    #[test]
    fn constant_images_have_the_worked_value() {
        let shape = Shape::new(1, 3, 4, 5);
        let e = photometric_value(&Tensor::full(shape, 0.5_f64), &Tensor::full(shape, 0.4));
        for &e in e.data() {
            // SSIM 0.975615703487: 0.85 * 0.5 * (1 - SSIM) + 0.15 * 0.1
            assert!((e - 0.025_363_326_018).abs() < 1e-11, "{e}");
        }
    }

    #[test]
    fn absolute_differences_are_averaged_over_channels() {
        let tape = Tape::<f64>::new();
        let pixel = |values: [f64; 3]| tape.leaf(Tensor::from_vec(Shape::new(1, 3, 1, 1), values.to_vec()));
        let (x, y) = (pixel([0.1, 0.5, 0.9]), pixel([0.4, 0.5, 0.3]));
        let e = absolute_difference(x, y);
        assert!((e.value().item() - 0.3).abs() < 1e-15);
        let third = 1.0 / 3.0;
        assert_eq!(tape.backward(e).wrt(x).data(), [-third, 0.0, third]);
    }

    #[test]
    fn windows_without_gradient_have_none_whatever_they_hold() {
        let shape = Shape::new(1, 3, 5, 18);
        let tape = Tape::new();
        let image = random::<f64>(1, shape, 0.0, 1.0);
        let hole = |n, c, h, w| if [c, h, w] == [0, 2, 3] { f64::NAN } else { image.at(n, c, h, w) };
        let x = tape.leaf(Tensor::from_fn(shape, hole));
        let y = tape.constant(random(2, shape, 0.0, 1.0));
        let error = photometric(x, y);
        assert!(error.value().at(0, 0, 2, 3).is_nan());
        let gradient = tape.backward(error.slice(3, 6, 12).sum()).wrt(x);
        let of_column = |w: usize| (0..5).map(|h| gradient.at(0, 0, h, w)).collect::<Vec<_>>();
        assert!((0..5).all(|w| of_column(w).iter().all(|&g| g == 0.0)));
        assert!((5..18).all(|w| of_column(w).iter().all(|&g| g != 0.0 && g.is_finite())));
    }

    #[test]
    fn any_number_of_threads_gives_the_same_bits() {
        let shape = Shape::new(2, 3, 67, 33);
        let run = |threads| {
            par::with_threads(threads, || {
                let tape = Tape::new();
                let [x, y] = [1, 2].map(|seed| tape.leaf(random::<f64>(seed, shape, 0.0, 1.0)));
                let error = photometric(x, y);
                let grads = tape.backward(weighted_sum(error, 3));
                [error.value(), grads.wrt(x), grads.wrt(y)].map(|t| t.data().iter().map(|x| x.to_bits()).collect::<Vec<_>>())
            })
        };
        let one = run(1);
        assert!((2..=4).all(|threads| run(threads) == one));
    }

    #[test]
    fn equal_images_have_no_error_and_no_gradient() {
        let x = random::<f64>(1, Shape::new(1, 3, 5, 6), 0.0, 1.0);
        let tape = Tape::new();
        let (a, b) = (tape.leaf(x.clone()), tape.leaf(x));
        let e = photometric(a, b);
        assert!(e.value().data().iter().all(|e| e.abs() < 1e-12));
        let grads = tape.backward(e.sum());
        for image in [a, b] {
            let grad = grads.get(image).expect("a path leads to both images");
            assert!(grad.data().iter().all(|g| g.abs() < 1e-12));
        }
    }

    #[test]
    fn gradient_matches_finite_differences() {
        for (i, [h, w]) in [[2, 2], [2, 5], [3, 3], [5, 4], [7, 6], [35, 9]].into_iter().enumerate() {
            let shape = Shape::new(2, 3, h, w);
            let (x, other) = (random(i as u64, shape, 0.0, 1.0), random(i as u64 + 30, shape, 0.0, 1.0));
            // Nearly equal colours would have their kink within the step.
            let apart = |(&x, &y): (&f64, &f64)| if (x - y).abs() < 1e-3 { x + 0.01 } else { y };
            let y = Tensor::from_vec(shape, x.data().iter().zip(other.data()).map(apart).collect());
            let step = GradCheck { step: 1e-5, rtol: 1e-6, ..GradCheck::default() };
            let report = gradcheck(&[x, y], |_, v| weighted_sum(photometric(v[0], v[1]), 8), step);
            assert!(report.is_ok(), "{h} x {w}: {report}");
        }
    }
}
