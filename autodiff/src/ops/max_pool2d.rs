//! Maximum over a k x k window, stride s, padding p that counts as minus infinity.
//!
//! y[i, j] = max over the window's elements inside the plane.
//! vjp: g goes to the first maximum in row-major window order.  Kinks: ties, resolved by that rule (as PyTorch).
//! Keeps: which element of its window each maximum is.
//! A NaN in the window gives NaN, and the gradient goes to the first NaN.

use pulp::{Arch, Simd, WithSimd};

use super::planes::{Window, for_each_plane};
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin};
use crate::{Scalar, Shape, Var, par};

/// Maximum and winner of every window of one plane, compiled for every instruction set.
struct Maxima<'a, T> {
    x: &'a [T],
    y: &'a mut [T],
    /// Which element of its window, in row-major order, each maximum is.
    winner: &'a mut [T],
    window: Window,
}

impl<T: Scalar> WithSimd for Maxima<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { x, y, winner, window } = self;
        let Window { width, kernel, stride, padding, out_width, .. } = window;
        // One stride more, so that every window's elements begin a whole step.
        let mut scratch = vec![T::NEG_INFINITY; width + 2 * padding + stride + out_width];
        // Behind: the elements `column` of all windows of a row, one after another.
        let (padded, column) = scratch.split_at_mut(width + 2 * padding + stride);
        let rows = y.chunks_exact_mut(out_width).zip(winner.chunks_exact_mut(out_width));
        for (oy, (best, winner)) in rows.enumerate() {
            let inside = window.rows(oy);
            let above = inside.start + padding - oy * stride;
            best.fill(T::NEG_INFINITY);
            for (ox, winner) in winner.iter_mut().enumerate() {
                *winner = T::from_usize(above * kernel + padding.saturating_sub(ox * stride));
            }
            for (k, row) in inside.enumerate() {
                padded[padding..padding + width].copy_from_slice(&x[row * width..][..width]);
                for dx in 0..kernel {
                    every(stride, &padded[dx..], column);
                    let tap = T::from_usize((above + k) * kernel + dx);
                    let (best, winner, column) = (&mut best[..out_width], &mut winner[..out_width], &column[..out_width]);
                    for i in 0..out_width {
                        // NaN wins over every number, and the first one stays.
                        let stays = best[i] >= column[i] || best[i].is_nan();
                        best[i] = if stays { best[i] } else { column[i] };
                        winner[i] = if stays { winner[i] } else { tap };
                    }
                }
            }
        }
    }
}

/// Copies every `stride`-th element; every second, the usual case, in a loop of its own.
#[inline(always)]
fn every<T: Scalar>(stride: usize, from: &[T], to: &mut [T]) {
    if stride == 2 {
        to.iter_mut().zip(from.as_chunks::<2>().0).for_each(|(to, [from, _])| *to = *from);
    } else {
        to.iter_mut().zip(from.iter().step_by(stride)).for_each(|(to, from)| *to = *from);
    }
}

fn backward_plane<T: Scalar>(winner: &[T], g: &[T], gx: &mut [T], window: Window) {
    let Window { width, kernel, stride, padding, out_width, .. } = window;
    let taps: Vec<usize> = (0..kernel * kernel).map(|tap| tap / kernel * width + tap % kernel).collect();
    gx.fill(T::ZERO);
    for (oy, (winner, g)) in winner.chunks_exact(out_width).zip(g.chunks_exact(out_width)).enumerate() {
        for (ox, (&winner, &g)) in winner.iter().zip(g).enumerate() {
            // The winner is inside, so that the sum is at least the padding.
            gx[oy * stride * width + ox * stride + taps[winner.to_f64() as usize] - padding * (width + 1)] += g;
        }
    }
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Maximum over square windows.
    ///
    /// **Shapes**: (N, C, H, W) to (N, C, floor((H + 2p - k)/s) + 1, floor((W + 2p - k)/s) + 1).
    /// **Gradient**: to the first maximum of each window in row-major order.
    /// **Domain**: padding counts as minus infinity; NaN wins over every number.
    /// **Panics** unless k, s >= 1, 2p <= k and the padded plane is at least as large as the window.
    #[track_caller]
    pub fn max_pool2d(self, kernel: usize, stride: usize, padding: usize) -> Var<'t, T> {
        let shape = self.shape();
        let window = Window::new("max_pool2d", shape, kernel, stride, padding);
        let out_shape = shape.with_plane(window.out_height, window.out_width);
        let (plane, out_plane) = (shape.plane(), out_shape.plane());
        let x = self.value();
        let [mut y, mut winners] = [(); 2].map(|()| self.tape().scratch(out_shape.len()));
        let planes = y.chunks_exact_mut(out_plane).zip(winners.chunks_exact_mut(out_plane)).collect();
        par::for_each_item(planes, |i, (y, winner)| {
            Arch::new().dispatch(Maxima { x: &x.data()[i * plane..][..plane], y, winner, window });
        });
        let [y, winners] = [y, winners].map(|buffer| self.tape().tensor(out_shape, buffer));
        self.tape().push("max_pool2d", y, &[self], move |g, grads| {
            if let Some(mut slot) = grads.slot(0) {
                slot.write(|gx| {
                    for_each_plane(gx, plane, |i, out| {
                        let outputs = i * out_plane..(i + 1) * out_plane;
                        backward_plane(&winners.data()[outputs.clone()], &g.data()[outputs], out, window);
                    });
                });
            }
        })
    }
}

#[derive(Clone, Copy, Debug)]
struct MaxPool2d {
    kernel: usize,
    stride: usize,
    padding: usize,
}

impl Twin for MaxPool2d {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].max_pool2d(self.kernel, self.stride, self.padding)
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let (x, k) = (&x[0], self.kernel);
        let size = |len: usize| (len + 2 * self.padding - k) / self.stride + 1;
        Plain::from_fn(x.shape.with_plane(size(x.shape.h()), size(x.shape.w())), |[n, c, i, j]| {
            let at = |first: usize, step| (first * self.stride + step) as isize - self.padding as isize;
            let places = (0..k * k).map(|t| (at(i, t / k), at(j, t % k)));
            let inside = places.filter(|&(h, w)| h >= 0 && w >= 0 && h < x.shape.h() as isize && w < x.shape.w() as isize);
            inside.map(|(h, w)| x.or_zero(n, c, h, w)).reduce(N::max).expect("every window meets the plane")
        })
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("max_pool2d");
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
            cases.push(Case::new(MaxPool2d { kernel, stride, padding }, [draw.distinct(shape)]));
        }
    }
    cases.push(Case::new(MaxPool2d { kernel: 3, stride: 2, padding: 1 }, [draw.distinct(Shape::new(2, 3, 11, 31))]));
    cases.push(Case::new(MaxPool2d { kernel: 2, stride: 2, padding: 0 }, [draw.distinct(Shape::new(2, 3, 10, 34))]));
    Proof::new("max_pool2d", cases)
}

#[cfg(test)]
mod tests {
    use crate::ops::planes::testing::{noise, tensor};
    use crate::ops::testing::{check, close};
    use crate::{Shape, Tape, Tensor};

    #[test]
    fn three_by_three_stride_two_of_a_small_plane() {
        let tape = Tape::new();
        let x = [-1.0, -2.0, -3.0, -4.0, 5.0, 0.0, 7.0, -8.0, 9.0, 2.0, 1.0, 0.0];
        let x = tape.leaf(tensor([1, 1, 3, 4], &x));
        let y = x.max_pool2d(3, 2, 1);
        close(y.value().data(), &[5.0, 7.0, 9.0, 7.0]);
        let mut expected = [0.0; 12];
        (expected[4], expected[6], expected[8]) = (1.0, 2.0, 1.0);
        close(tape.backward(y.sum()).wrt(x).data(), &expected);
    }

    #[test]
    fn padding_never_wins() {
        let tape = Tape::new();
        let x = tape.constant(Tensor::full(Shape::new(1, 2, 3, 5), -7.0));
        let y = x.max_pool2d(2, 1, 1).value();
        assert_eq!(y.shape(), Shape::new(1, 2, 4, 6));
        close(y.data(), &[-7.0; 48]);
    }

    #[test]
    fn the_first_of_equal_maxima_takes_the_gradient() {
        let tape = Tape::new();
        let x = tape.leaf(Tensor::full(Shape::new(1, 1, 2, 4), 3.0));
        let grads = tape.backward(x.max_pool2d(2, 2, 0).sum());
        close(grads.wrt(x).data(), &[1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn not_a_number_is_not_hidden() {
        let tape = Tape::new();
        let x = tape.leaf(tensor([1, 1, 2, 2], &[1.0, f64::NAN, 5.0, 2.0]));
        let y = x.max_pool2d(2, 2, 0);
        assert!(y.value().item().is_nan());
        close(tape.backward(y).wrt(x).data(), &[0.0, 1.0, 0.0, 0.0]);
    }

    #[test]
    fn gradient_matches_finite_differences() {
        for (sizes, k, s, p) in
            [([2, 2, 5, 7], 3, 2, 1), ([1, 3, 4, 3], 2, 1, 0), ([1, 1, 1, 6], 3, 3, 1), ([1, 1, 6, 5], 4, 1, 2)]
        {
            check(&[noise(5, sizes)], |v| v[0].max_pool2d(k, s, p));
        }
    }

    #[test]
    #[should_panic(expected = "max_pool2d: input [1, 1, 2, 3] with padding 0")]
    fn rejects_planes_smaller_than_the_window() {
        let tape = Tape::new();
        tape.constant(noise(1, [1, 1, 2, 3])).max_pool2d(3, 1, 0);
    }
}
