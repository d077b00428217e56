//! Correlation of every pixel with its neighbours in a second map: the affinity of a square window.
//!
//! `y[n, k, i, j] = Σ_c a[n, c, i, j] b[n, c, i + dy, j + dx]` for the offsets `(dy, dx)` of a window of side `2 r + 1`, `dy` slow
//! and `dx` fast; `b` is zero outside. Vector-Jacobian products: `Σ_k g[k, i, j] b[c, i + dy, j + dx]` to `a`, and
//! `Σ_k g[k, i - dy, j - dx] a[c, i - dy, j - dx]` to `b`. Bilinear, no kinks. Keeps both maps, each only when the other one needs
//! its gradient.
//!
//! The feature flow of SCIPaD is a softmax over such windows of side 9, 5 and 3.

use super::planes::for_each_plane;
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, total};
use crate::{Scalar, Shape, Tensor, Var};

/// Sizes of both maps, and the radius of the window.
#[derive(Clone, Copy, Debug)]
struct Window {
    shape: Shape,
    radius: usize,
}

/// The first of `size` positions that stay inside when moved by `offset`, and how many do.
fn inside(size: usize, offset: isize) -> (usize, usize) {
    ((-offset).max(0) as usize, size.saturating_sub(offset.unsigned_abs()))
}

impl Window {
    /// Number of offsets.
    fn offsets(self) -> usize {
        let side = 2 * self.radius + 1;
        side * side
    }

    /// `[dy, dx]` of offset `k`.
    fn offset(self, k: usize) -> [isize; 2] {
        let (side, radius) = (2 * self.radius + 1, self.radius as isize);
        [(k / side) as isize - radius, (k % side) as isize - radius]
    }

    /// Visits, in rows, the positions that stay inside when moved by `[dy, dx]`: the first position of a row, the same moved, and
    /// the length of the row.
    fn rows(self, [dy, dx]: [isize; 2], mut visit: impl FnMut(usize, usize, usize)) {
        let ((top, rows), (left, width)) = (inside(self.shape.h(), dy), inside(self.shape.w(), dx));
        for i in top..top + rows {
            let start = i * self.shape.w() + left;
            let moved = (i as isize + dy) * self.shape.w() as isize + left as isize + dx;
            if width > 0 {
                visit(start, moved as usize, width);
            }
        }
    }

    /// One sample of a map.
    fn sample<T>(self, map: &[T], n: usize) -> &[T] {
        let len = self.shape.c() * self.shape.plane();
        &map[n * len..][..len]
    }

    /// One plane of what belongs to the offsets.
    fn of_offset<T>(self, g: &[T], n: usize, k: usize) -> &[T] {
        &g[(n * self.offsets() + k) * self.shape.plane()..][..self.shape.plane()]
    }

    fn forward<T: Scalar>(self, a: &[T], b: &[T], y: &mut [T]) {
        for_each_plane(y, self.shape.plane(), |plane, out| {
            let (n, k) = (plane / self.offsets(), plane % self.offsets());
            out.fill(T::ZERO);
            let planes = self.sample(a, n).chunks_exact(out.len()).zip(self.sample(b, n).chunks_exact(out.len()));
            for (a, b) in planes {
                self.rows(self.offset(k), |at, moved, len| add_products(&mut out[at..][..len], &a[at..], &b[moved..]));
            }
        });
    }

    fn backward_first<T: Scalar>(self, g: &[T], b: &[T], gradient: &mut [T]) {
        for_each_plane(gradient, self.shape.plane(), |plane, out| {
            let b = &b[plane * out.len()..][..out.len()];
            out.fill(T::ZERO);
            for k in 0..self.offsets() {
                let g = self.of_offset(g, plane / self.shape.c(), k);
                self.rows(self.offset(k), |at, moved, len| add_products(&mut out[at..][..len], &g[at..], &b[moved..]));
            }
        });
    }

    fn backward_second<T: Scalar>(self, g: &[T], a: &[T], gradient: &mut [T]) {
        for_each_plane(gradient, self.shape.plane(), |plane, out| {
            let a = &a[plane * out.len()..][..out.len()];
            out.fill(T::ZERO);
            for k in 0..self.offsets() {
                let g = self.of_offset(g, plane / self.shape.c(), k);
                self.rows(self.offset(k), |at, moved, len| add_products(&mut out[moved..][..len], &g[at..], &a[at..]));
            }
        });
    }
}

/// `sum[i] += x[i] y[i]`.
fn add_products<T: Scalar>(sum: &mut [T], x: &[T], y: &[T]) {
    for ((sum, &x), &y) in sum.iter_mut().zip(x).zip(y) {
        *sum += x * y;
    }
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Inner products over the channels of every pixel with the pixels of `other` in a square window around the same place.
    ///
    /// **Shapes**: twice (N, C, H, W) to (N, (2 radius + 1)², H, W); channel k belongs to the offset
    /// (dy, dx) = (k / side - radius, k mod side - radius).
    /// **Gradient**: to both maps.
    ///
    /// # Panics
    /// When the shapes differ.
    #[track_caller]
    pub fn window_correlation(self, other: Var<'t, T>, radius: usize) -> Var<'t, T> {
        let shape = self.shape();
        assert!(shape == other.shape(), "window_correlation: maps {shape} and {}; the rule: one shape", other.shape());
        let window = Window { shape, radius };
        let (a, b) = (self.value(), other.value());
        let to = Shape::new(shape.n(), window.offsets(), shape.h(), shape.w());
        let mut y = self.tape().scratch(to.len());
        window.forward(a.data(), b.data(), &mut y);
        let y = self.tape().tensor(to, y);
        let a: Option<Tensor<T>> = other.requires_grad().then_some(a);
        let b: Option<Tensor<T>> = self.requires_grad().then_some(b);
        self.tape().push("window_correlation", y, &[self, other], move |g, grads| {
            if let (Some(mut slot), Some(b)) = (grads.slot(0), &b) {
                slot.write(|out| window.backward_first(g.data(), b.data(), out));
            }
            if let (Some(mut slot), Some(a)) = (grads.slot(1), &a) {
                slot.write(|out| window.backward_second(g.data(), a.data(), out));
            }
        })
    }
}

#[derive(Clone, Copy, Debug)]
struct WindowCorrelation {
    radius: usize,
}

impl Twin for WindowCorrelation {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].window_correlation(v[1], self.radius)
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let ([n, c, h, w], r) = (x[0].shape.0, self.radius);
        let side = 2 * r + 1;
        Plain::from_fn(Shape::new(n, side * side, h, w), |[n, k, i, j]| {
            let (y, z) = ((i + k / side) as isize - r as isize, (j + k % side) as isize - r as isize);
            total((0..c).map(|c| x[0].at([n, c, i, j]) * x[1].or_zero(n, c, y, z)))
        })
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("window_correlation");
    let mut cases = Vec::new();
    // Windows larger than the map, of one pixel, and of the sides 9, 5 and 3.
    let sizes = [
        ([1, 1, 1, 1], 0),
        ([1, 2, 1, 1], 2),
        ([2, 3, 3, 4], 1),
        ([1, 5, 2, 7], 2),
        ([3, 1, 5, 1], 4),
        ([2, 2, 4, 3], 1),
        ([2, 2, 3, 4], 2),
        ([1, 2, 6, 5], 4),
        ([2, 17, 7, 9], 1),
        ([1, 9, 15, 16], 1),
    ];
    for (i, (shape, radius)) in sizes.into_iter().enumerate() {
        let inputs = [draw.uniform(Shape(shape), -1.0, 1.0), draw.uniform(Shape(shape), -1.0, 1.0)];
        let case = Case::new(WindowCorrelation { radius }, inputs);
        cases.push(if (5..7).contains(&i) { case.constant(i - 5) } else { case });
    }
    Proof::new("window_correlation", cases)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::planes::testing::tensor;
    use crate::ops::testing::{self, close, random};
    use crate::{Shape, Tape};

    #[test]
    fn worked_numbers_with_zeros_outside() {
        let tape = Tape::new();
        let a = tape.leaf(tensor([1, 2, 1, 2], &[1.0, 2.0, 3.0, 4.0]));
        let b = tape.leaf(tensor([1, 2, 1, 2], &[5.0, 6.0, 7.0, 8.0]));
        let y = a.window_correlation(b, 1);
        assert_eq!(y.shape(), Shape::new(1, 9, 1, 2));
        let mut expected = vec![0.0; 18];
        // Left neighbour, itself, right neighbour.
        expected[6..12].copy_from_slice(&[0.0, 2.0 * 5.0 + 4.0 * 7.0, 5.0 + 21.0, 12.0 + 32.0, 6.0 + 24.0, 0.0]);
        close(y.value().data(), &expected);
        let grads = tape.backward(y.sum());
        close(grads.wrt(a).data(), &[11.0, 11.0, 15.0, 15.0]);
        close(grads.wrt(b).data(), &[3.0, 3.0, 7.0, 7.0]);
    }

    #[test]
    fn a_window_of_one_pixel_is_the_inner_product() {
        let tape = Tape::new();
        let (a, b) = (random(1, Shape::new(2, 3, 4, 5), -1.0, 1.0), random(2, Shape::new(2, 3, 4, 5), -1.0, 1.0));
        let (a, b) = (tape.constant(a), tape.constant(b));
        close(a.window_correlation(b, 0).value().data(), a.mul(b).mean_channels().scale(3.0).value().data());
    }

    #[test]
    #[should_panic(expected = "window_correlation: maps [1, 2, 3, 3] and [1, 2, 3, 4]; the rule: one shape")]
    fn rejects_maps_of_different_sizes() {
        let tape = Tape::<f64>::new();
        let map = |w| tape.constant(random(1, Shape::new(1, 2, 3, w), -1.0, 1.0));
        map(3).window_correlation(map(4), 1);
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), radius in 0..3usize, seed in any::<u64>()) {
            let maps = [random(seed, shape, -1.0, 1.0), random(seed ^ 1, shape, -1.0, 1.0)];
            testing::check(&maps, |v| v[0].window_correlation(v[1], radius));
        }
    }
}
