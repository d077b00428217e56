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

use dimode_autodiff::{Scalar, Shape, Tensor, Var, par};
use pulp::{Arch, Simd, WithSimd};

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
    let size = Size { h: shape.h(), w: shape.w() };
    par::for_each_chunk(&mut out, shape.plane(), |n, out| {
        out.fill(T::ZERO);
        let mut work = Work::new(size.len());
        for c in 0..shape.c() {
            let task = Forward { x: x.plane(n, c), y: y.plane(n, c), size, scale: 1.0 / shape.c() as f64, work: &mut work, out };
            Arch::new().dispatch(task);
        }
    });
    let output = tape.tensor(shape.with_c(1), out);
    tape.push("photometric", output, &[warped, target], move |g, grads| {
        for (slot, [x, y]) in [[&x, &y], [&y, &x]].into_iter().enumerate() {
            if let Some(mut slot) = grads.slot(slot) {
                backward(x, y, g, slot.as_mut_slice());
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

/// Adds the gradient with respect to `x`; the operation is symmetric in its images.
fn backward<T: Scalar>(x: &Tensor<T>, y: &Tensor<T>, g: &Tensor<T>, dx: &mut [T]) {
    let shape: Shape = x.shape();
    let size = Size { h: shape.h(), w: shape.w() };
    par::for_each_chunk(dx, shape.c() * shape.plane(), |n, dx| {
        let mut work = Work::new(size.len());
        for (c, dx) in dx.chunks_exact_mut(shape.plane()).enumerate() {
            let scale = 1.0 / shape.c() as f64;
            let task = Backward { x: x.plane(n, c), y: y.plane(n, c), g: g.plane(n, 0), size, scale, work: &mut work, dx };
            Arch::new().dispatch(task);
        }
    });
}

#[derive(Clone, Copy)]
struct Size {
    h: usize,
    w: usize,
}

impl Size {
    fn len(self) -> usize {
        self.h * self.w
    }
}

/// Scratch planes: shifted colours, five box means, one temporary.
struct Work<T> {
    x: Vec<T>,
    y: Vec<T>,
    means: [Vec<T>; 5],
    product: Vec<T>,
    rows: Vec<T>,
}

impl<T: Scalar> Work<T> {
    fn new(len: usize) -> Self {
        let plane = || vec![T::ZERO; len];
        Work { x: plane(), y: plane(), means: [plane(), plane(), plane(), plane(), plane()], product: plane(), rows: plane() }
    }

    /// Fills the means of x, y, xx, yy, xy of colours moved by [`SHIFT`].
    #[inline(always)]
    fn fill(&mut self, x: &[T], y: &[T], size: Size) {
        let shift = T::from_f64(SHIFT);
        for (o, &v) in self.x.iter_mut().zip(x) {
            *o = v - shift;
        }
        for (o, &v) in self.y.iter_mut().zip(y) {
            *o = v - shift;
        }
        box_mean(&self.x, &mut self.rows, &mut self.means[0], size);
        box_mean(&self.y, &mut self.rows, &mut self.means[1], size);
        for k in 2..5 {
            let (a, b) = match k {
                2 => (&self.x, &self.x),
                3 => (&self.y, &self.y),
                _ => (&self.x, &self.y),
            };
            for ((o, &a), &b) in self.product.iter_mut().zip(a).zip(b) {
                *o = a * b;
            }
            box_mean(&self.product, &mut self.rows, &mut self.means[k], size);
        }
    }
}

/// 3 x 3 mean with mirrored borders.
#[inline(always)]
fn box_mean<T: Scalar>(x: &[T], rows: &mut [T], out: &mut [T], size: Size) {
    let Size { h, w } = size;
    for i in 0..h {
        let (up, down) = (if i == 0 { 1 } else { i - 1 }, if i + 1 == h { h - 2 } else { i + 1 });
        let (a, b, c) = (&x[up * w..][..w], &x[i * w..][..w], &x[down * w..][..w]);
        for (((o, &a), &b), &c) in rows[i * w..][..w].iter_mut().zip(a).zip(b).zip(c) {
            *o = a + b + c;
        }
    }
    let ninth = T::from_f64(1.0 / 9.0);
    for (out, r) in out.chunks_exact_mut(w).zip(rows.chunks_exact(w)) {
        out[0] = (r[0] + r[1] + r[1]) * ninth;
        for ((o, l), (&m, &n)) in out[1..].iter_mut().zip(&r[..w - 2]).zip(r[1..].iter().zip(&r[2..])) {
            *o = (*l + m + n) * ninth;
        }
        out[w - 1] = (r[w - 1] + r[w - 2] + r[w - 2]) * ninth;
    }
}

/// Transposed [`box_mean`], in place on `x`.
#[inline(always)]
fn box_mean_transposed<T: Scalar>(x: &mut [T], rows: &mut [T], size: Size) {
    let Size { h, w } = size;
    let ninth = T::from_f64(1.0 / 9.0);
    for (o, g) in rows.chunks_exact_mut(w).zip(x.chunks_exact(w)) {
        o[0] = g[0] + g[1];
        for ((o, l), (&m, &n)) in o[1..].iter_mut().zip(&g[..w - 2]).zip(g[1..].iter().zip(&g[2..])) {
            *o = *l + m + n;
        }
        o[w - 1] = g[w - 1] + g[w - 2];
        o[1] += g[0];
        o[w - 2] += g[w - 1];
    }
    for i in 0..h {
        let out = &mut x[i * w..][..w];
        out.copy_from_slice(&rows[i * w..][..w]);
        // Rows that read row i: its neighbours, and the border rows once more through the mirror.
        let above = (i > 0).then(|| i - 1);
        let below = (i + 1 < h).then_some(i + 1);
        let mirrored = [(i == 1).then_some(0), (i + 2 == h).then_some(h - 1)];
        for j in [above, below].into_iter().chain(mirrored).flatten() {
            for (o, &r) in out.iter_mut().zip(&rows[j * w..][..w]) {
                *o += r;
            }
        }
        for o in out.iter_mut() {
            *o *= ninth;
        }
    }
}

/// The factors of SSIM at one pixel: `[mx, my, a1, a2, b1, b2]`, means with the shift put back.
#[inline(always)]
fn factors<T: Scalar>(m: [T; 5]) -> [T; 6] {
    let [x, y, xx, yy, xy] = m;
    let shift = T::from_f64(SHIFT);
    let two = T::from_f64(2.0);
    let (mx, my) = (x + shift, y + shift);
    let a1 = two * mx * my + T::from_f64(C1);
    let a2 = two * (xy - x * y) + T::from_f64(C2);
    let b1 = mx * mx + my * my + T::from_f64(C1);
    let b2 = (xx - x * x) + (yy - y * y) + T::from_f64(C2);
    [mx, my, a1, a2, b1, b2]
}

struct Forward<'a, T> {
    x: &'a [T],
    y: &'a [T],
    size: Size,
    scale: f64,
    work: &'a mut Work<T>,
    out: &'a mut [T],
}

impl<T: Scalar> WithSimd for Forward<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        self.work.fill(self.x, self.y, self.size);
        let [x, y, xx, yy, xy] = &self.work.means;
        let half = T::from_f64(0.5);
        let (dissim, absolute) = (T::from_f64(ALPHA * self.scale), T::from_f64((1.0 - ALPHA) * self.scale));
        let len = self.size.len();
        let (x, y, xx, yy, xy) = (&x[..len], &y[..len], &xx[..len], &yy[..len], &xy[..len]);
        let (cx, cy, out) = (&self.x[..len], &self.y[..len], &mut self.out[..len]);
        for i in 0..len {
            let [_, _, a1, a2, b1, b2] = factors([x[i], y[i], xx[i], yy[i], xy[i]]);
            let d = (T::ONE - a1 * a2 / (b1 * b2)) * half;
            let d = d.max(T::ZERO).min(T::ONE);
            out[i] += dissim * d + absolute * (cx[i] - cy[i]).abs();
        }
    }
}

struct Backward<'a, T> {
    x: &'a [T],
    y: &'a [T],
    g: &'a [T],
    size: Size,
    scale: f64,
    work: &'a mut Work<T>,
    dx: &'a mut [T],
}

impl<T: Scalar> WithSimd for Backward<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let work = self.work;
        work.fill(self.x, self.y, self.size);
        let len = self.size.len();
        let weight = T::from_f64(-0.5 * ALPHA * self.scale);
        let two = T::from_f64(2.0);
        {
            // The means are replaced by the gradients of m_x, m_xx and m_xy.
            let [x, y, xx, yy, xy] = &mut work.means;
            let (x, y, xx, yy, xy) = (&mut x[..len], &y[..len], &mut xx[..len], &yy[..len], &mut xy[..len]);
            let g = &self.g[..len];
            for i in 0..len {
                let [mx, my, a1, a2, b1, b2] = factors([x[i], y[i], xx[i], yy[i], xy[i]]);
                let bottom = T::ONE / (b1 * b2);
                let s = a1 * a2 * bottom;
                let inside = s < T::ONE && s > -T::ONE;
                let g = if inside { g[i] * weight } else { T::ZERO };
                // Variance and covariance are those of shifted colours: their means are x and y, not mx and my.
                let (sx, sy) = (x[i], y[i]);
                let by_mean = (two * my * a2 - two * sy * a1) * bottom - s * (two * mx / b1 - two * sx / b2);
                x[i] = g * by_mean;
                xx[i] = -g * s / b2;
                xy[i] = g * two * a1 * bottom;
            }
        }
        for k in [0, 2, 4] {
            box_mean_transposed(&mut work.means[k], &mut work.rows, self.size);
        }
        let absolute = T::from_f64((1.0 - ALPHA) * self.scale);
        let [a, _, b, _, c] = &work.means;
        let (a, b, c) = (&a[..len], &b[..len], &c[..len]);
        let (x, y, g, dx) = (&work.x[..len], &work.y[..len], &self.g[..len], &mut self.dx[..len]);
        for i in 0..len {
            let sign = if x[i] > y[i] {
                T::ONE
            } else if x[i] < y[i] {
                -T::ONE
            } else {
                T::ZERO
            };
            dx[i] += a[i] + two * x[i] * b[i] + y[i] * c[i] + absolute * sign * g[i];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::gradcheck::{random, weighted_sum};
    use dimode_autodiff::{GradCheck, Tape, gradcheck};

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
        for (i, [h, w]) in [[2, 2], [2, 5], [3, 3], [5, 4], [7, 6]].into_iter().enumerate() {
            let shape = Shape::new(2, 3, h, w);
            let (x, y) = (random(i as u64, shape, 0.0, 1.0), random(i as u64 + 30, shape, 0.0, 1.0));
            let step = GradCheck { step: 1e-5, rtol: 1e-6, ..GradCheck::default() };
            let report = gradcheck(&[x, y], |_, v| weighted_sum(photometric(v[0], v[1]), 8), step);
            assert!(report.is_ok(), "{h} x {w}: {report}");
        }
    }
}
