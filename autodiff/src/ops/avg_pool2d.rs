//! Mean over a k x k window, stride s, zero padding p that counts: the divisor is k^2 everywhere.
//!
//! y[i, j] = 1/k^2 sum of the window's elements inside the plane.
//! vjp: g/k^2 to every covered element.  Kinks: none, the op is linear.  Keeps: nothing.

use super::planes::{Window, add_row, add_scaled_row, for_each_plane};
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, total};
use crate::{Scalar, Shape, Var};

/// Two by two windows side by side: the pyramid of a correlation volume, worth its own loop.
fn forward_halves<T: Scalar>(x: &[T], y: &mut [T], window: Window) {
    let (width, out_width) = (window.width, window.out_width);
    let quarter = T::from_f64(0.25);
    for (rows, out) in x.chunks_exact(2 * width).zip(y.chunks_exact_mut(out_width)) {
        let (upper, lower) = rows.split_at(width);
        for ((o, a), b) in out.iter_mut().zip(upper.chunks_exact(2)).zip(lower.chunks_exact(2)) {
            *o = ((a[0] + a[1]) + (b[0] + b[1])) * quarter;
        }
    }
}

fn backward_halves<T: Scalar>(g: &[T], gx: &mut [T], window: Window) {
    let (width, out_width) = (window.width, window.out_width);
    let quarter = T::from_f64(0.25);
    for (rows, grad) in gx.chunks_exact_mut(2 * width).zip(g.chunks_exact(out_width)) {
        let (upper, lower) = rows.split_at_mut(width);
        let pairs = upper.chunks_exact_mut(2).zip(lower.chunks_exact_mut(2));
        for ((a, b), &g) in pairs.zip(grad) {
            let share = g * quarter;
            (a[0], a[1], b[0], b[1]) = (share, share, share, share);
        }
    }
}

fn forward_plane<T: Scalar>(x: &[T], y: &mut [T], window: Window) {
    let Window { width, kernel, stride, padding, .. } = window;
    let scale = T::from_f64(1.0 / (kernel * kernel) as f64);
    let mut column = vec![T::ZERO; width + 2 * padding];
    for (oy, out) in y.chunks_exact_mut(window.out_width).enumerate() {
        let middle = &mut column[padding..padding + width];
        middle.fill(T::ZERO);
        for row in window.rows(oy) {
            add_row(middle, &x[row * width..][..width]);
        }
        for (o, values) in out.iter_mut().zip(column.windows(kernel).step_by(stride)) {
            *o = values.iter().fold(T::ZERO, |sum, &v| sum + v) * scale;
        }
    }
}

fn backward_plane<T: Scalar>(g: &[T], gx: &mut [T], window: Window) {
    let Window { width, kernel, stride, padding, .. } = window;
    let scale = T::from_f64(1.0 / (kernel * kernel) as f64);
    let mut column = vec![T::ZERO; width + 2 * padding];
    for (oy, grad) in g.chunks_exact(window.out_width).enumerate() {
        column.fill(T::ZERO);
        for (ox, &g) in grad.iter().enumerate() {
            for v in &mut column[ox * stride..][..kernel] {
                *v += g;
            }
        }
        for row in window.rows(oy) {
            add_scaled_row(&mut gx[row * width..][..width], scale, &column[padding..padding + width]);
        }
    }
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Mean over square windows; padding counts as zeros, so the divisor is always `kernel * kernel`.
    ///
    /// **Shapes**: (N, C, H, W) to (N, C, floor((H + 2p - k)/s) + 1, floor((W + 2p - k)/s) + 1).
    /// **Gradient**: g/k^2 to every covered element.
    /// **Panics** unless k, s >= 1, 2p <= k and the padded plane is at least as large as the window.
    /// Equals PyTorch's `avg_pool2d` with its defaults (`count_include_pad=True`, floor).
    #[track_caller]
    pub fn avg_pool2d(self, kernel: usize, stride: usize, padding: usize) -> Var<'t, T> {
        let shape = self.shape();
        let window = Window::new("avg_pool2d", shape, kernel, stride, padding);
        let out_shape = shape.with_plane(window.out_height, window.out_width);
        let (plane, out_plane) = (shape.plane(), out_shape.plane());
        let halves = (kernel, stride, padding) == (2, 2, 0);
        let x = self.value();
        let mut y = self.tape().scratch(out_shape.len());
        for_each_plane(&mut y, out_plane, |i, out| {
            let forward = if halves { forward_halves } else { forward_plane };
            forward(&x.data()[i * plane..][..plane], out, window);
        });
        let y = self.tape().tensor(out_shape, y);
        self.tape().push("avg_pool2d", y, &[self], move |g, grads| {
            if let Some(mut slot) = grads.slot(0) {
                slot.write(|gx| {
                    for_each_plane(gx, plane, |i, out| {
                        let backward = if halves { backward_halves } else { backward_plane };
                        out.fill(T::ZERO);
                        backward(&g.data()[i * out_plane..][..out_plane], out, window);
                    });
                });
            }
        })
    }
}

#[derive(Clone, Copy, Debug)]
struct AvgPool2d {
    kernel: usize,
    stride: usize,
    padding: usize,
}

impl Twin for AvgPool2d {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].avg_pool2d(self.kernel, self.stride, self.padding)
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let (x, k) = (&x[0], self.kernel);
        let size = |len: usize| (len + 2 * self.padding - k) / self.stride + 1;
        Plain::from_fn(x.shape.with_plane(size(x.shape.h()), size(x.shape.w())), |[n, c, i, j]| {
            let at = |first: usize, step| (first * self.stride + step) as isize - self.padding as isize;
            let places = (0..k * k).map(|t| (at(i, t / k), at(j, t % k)));
            total(places.map(|(h, w)| x.or_zero(n, c, h, w))) / N::constant((k * k) as f64)
        })
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("avg_pool2d");
    let mut cases = Vec::new();
    for (kernel, stride, padding) in [
        (1, 1, 0),
        (2, 2, 0),
        (2, 2, 1),
        (2, 1, 0),
        (3, 1, 1),
        (3, 2, 1),
        (3, 2, 0),
        (3, 3, 0),
        (2, 3, 1),
        (5, 2, 2),
        (4, 3, 2),
        (1, 2, 0),
    ] {
        let least = kernel - padding.min(kernel - 1);
        for most in [0, 1, 4, 6] {
            let [n, c] = [draw.size(1, 2), draw.size(1, 3)];
            let shape = Shape::new(n, c, least + draw.size(0, most), least + draw.size(0, most));
            cases.push(Case::new(AvgPool2d { kernel, stride, padding }, [draw.uniform(shape, -1.0, 1.0)]));
        }
    }
    cases.push(Case::new(AvgPool2d { kernel: 3, stride: 2, padding: 1 }, [draw.uniform(Shape::new(2, 3, 11, 31), -1.0, 1.0)]));
    cases.push(Case::new(AvgPool2d { kernel: 2, stride: 2, padding: 0 }, [draw.uniform(Shape::new(2, 3, 10, 34), -1.0, 1.0)]));
    Proof::new("avg_pool2d", cases)
}

#[cfg(test)]
mod tests {
    use crate::ops::planes::testing::{noise, tensor};
    use crate::ops::testing::{check, check_adjoint, close};
    use crate::{Shape, Tape, Tensor};

    #[test]
    fn padding_counts_in_the_divisor() {
        let tape = Tape::new();
        let x = tape.constant(Tensor::full(Shape::new(1, 1, 4, 4), 9.0));
        close(x.avg_pool2d(3, 2, 1).value().data(), &[4.0, 6.0, 6.0, 9.0]);
    }

    #[test]
    fn halving_drops_the_odd_row_and_column() {
        let tape = Tape::new();
        let x: Vec<f64> = (0..15).map(f64::from).collect();
        let x = tape.leaf(tensor([1, 1, 3, 5], &x));
        let y = x.avg_pool2d(2, 2, 0);
        close(y.value().data(), &[3.0, 5.0]);
        let mut expected = [0.25; 15];
        expected[10..].fill(0.0);
        (expected[4], expected[9]) = (0.0, 0.0);
        close(tape.backward(y.sum()).wrt(x).data(), &expected);
    }

    #[test]
    fn the_special_loop_equals_the_general_one() {
        for (height, width) in [(2, 2), (5, 4), (4, 7)] {
            let window = super::Window::new("test", Shape::new(1, 1, height, width), 2, 2, 0);
            let x = noise(8, [1, 1, height, width]);
            let g = noise(9, [1, 1, height / 2, width / 2]);
            let (mut a, mut b) = (vec![0.0; g.data().len()], vec![0.0; g.data().len()]);
            super::forward_halves(x.data(), &mut a, window);
            super::forward_plane(x.data(), &mut b, window);
            close(&a, &b);
            let (mut a, mut b) = (vec![0.0; height * width], vec![0.0; height * width]);
            super::backward_halves(g.data(), &mut a, window);
            super::backward_plane(g.data(), &mut b, window);
            close(&a, &b);
        }
    }

    #[test]
    fn transpose_and_finite_differences() {
        for (sizes, k, s, p) in [
            ([2, 2, 5, 7], 3, 2, 1),
            ([1, 3, 4, 3], 2, 2, 0),
            ([1, 1, 1, 6], 3, 3, 1),
            ([3, 1, 6, 5], 4, 1, 2),
            ([2, 1, 1, 1], 1, 1, 0),
        ] {
            check_adjoint(Shape(sizes), 6, |x| x.avg_pool2d(k, s, p));
        }
        check(&[noise(5, [1, 2, 5, 4])], |v| v[0].avg_pool2d(3, 2, 1).square());
    }

    #[test]
    #[should_panic(expected = "with padding 2; the rule: at most half of the kernel 3")]
    fn rejects_padding_above_half_the_window() {
        let tape = Tape::new();
        tape.constant(noise(1, [1, 1, 4, 4])).avg_pool2d(3, 1, 2);
    }
}
