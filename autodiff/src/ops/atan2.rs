//! `θ = atan2(y, x)`: the angle of the vector `(x, y)`, radians in `[-π, π]`. Vector-Jacobian products with
//! `r² = x² + y²`: `g x / r²` to `y`, `-g y / r²` to `x`, so the slope is bounded by `1 / r`. Keeps: both operands.
//!
//! At the origin the angle is 0 and the gradient is set to 0 (no direction is better than another). The cut along the
//! negative `x` axis does not show in the gradient. The quotients are formed after division by `max(|x|, |y|)`, so that
//! neither large nor tiny finite vectors overflow. NaN stays NaN.

use super::{binary, kernel};
use crate::proof::{Draw, Number, Plain, Proof, Twin};
use crate::{Scalar, Var};

fn forward<T: Scalar>(y: &[T], x: &[T], angle: &mut [T]) {
    kernel::zip(angle, y, x, |y, x| y.atan2(x));
}

fn backward_y<T: Scalar>(y: &[T], x: &[T], grad: &[T], grad_y: &mut [T]) {
    kernel::zip3(grad_y, y, x, grad, |y, x, g| along(x, y, g));
}

fn backward_x<T: Scalar>(y: &[T], x: &[T], grad: &[T], grad_x: &mut [T]) {
    kernel::zip3(grad_x, y, x, grad, |y, x, g| -along(y, x, g));
}

/// `g a / (a² + b²)`, 0 at the origin.
#[inline(always)]
fn along<T: Scalar>(a: T, b: T, g: T) -> T {
    let size = a.abs().max(b.abs());
    let (a, b) = (a / size, b / size);
    if size == T::ZERO { T::ZERO } else { g * (a / (a * a + b * b)) / size }
}

impl<'t, T: Scalar> Var<'t, T> {
    /// The angle of the vector (`x`, `self`), in radians.
    ///
    /// **Gradient**: `g x / r²` to `self`, `-g self / r²` to `x`, with `r² = x² + self²`; 0 at the origin.
    ///
    /// **Panics** when the shapes differ.
    #[track_caller]
    pub fn atan2(self, x: Var<'t, T>) -> Var<'t, T> {
        binary::keep_both("atan2", self, x, forward, backward_y, backward_x)
    }
}

#[derive(Clone, Copy, Debug)]
struct Atan2;

impl Twin for Atan2 {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].atan2(v[1])
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        x[0].zip(&x[1], N::atan2)
    }
}

pub(crate) fn proof() -> Proof {
    Proof::binary("atan2", Atan2, |draw: &mut Draw, shape| [draw.weights(shape), draw.weights(shape)])
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random_away, row, slopes2, values2};
    use crate::{Shape, Tape, Tensor};

    #[test]
    fn values_and_slopes_are_known() {
        let (y, x) = ([1.0, 4.0, 0.0, -1.0], [1.0, 3.0, -2.0, 0.0]);
        close(&values2(&y, &x, |y, x| y.atan2(x)), &[PI / 4.0, 4.0_f64.atan2(3.0), PI, -PI / 2.0]);
        let (to_y, to_x) = slopes2(&y, &x, |y, x| y.atan2(x));
        close(&to_y, &[0.5, 0.12, -0.5, 0.0]);
        close(&to_x, &[-0.5, -0.16, 0.0, 1.0]);
    }

    #[test]
    fn gradient_at_the_origin_is_zero() {
        close(&values2(&[0.0], &[0.0], |y, x| y.atan2(x)), &[0.0]);
        let (to_y, to_x) = slopes2(&[0.0], &[0.0], |y, x| y.atan2(x));
        close(&[to_y[0], to_x[0]], &[0.0, 0.0]);
    }

    #[test]
    fn tiny_and_large_vectors_neither_overflow_nor_vanish() {
        let (to_y, to_x) = slopes2(&[1e-200, 1e200], &[1e-200, 1e200], |y, x| y.atan2(x));
        assert!((to_y[0] * 1e-200 - 0.5).abs() < 1e-12 && (to_x[0] * 1e-200 + 0.5).abs() < 1e-12);
        assert!((to_y[1] * 1e200 - 0.5).abs() < 1e-12 && (to_x[1] * 1e200 + 0.5).abs() < 1e-12);
    }

    #[test]
    fn nan_is_not_hidden() {
        let y = values2(&[f64::NAN, 1.0], &[1.0, f64::NAN], |y, x| y.atan2(x));
        assert!(y.iter().all(|y| y.is_nan()));
        let (to_y, to_x) = slopes2(&[f64::NAN, 1.0], &[1.0, f64::NAN], |y, x| y.atan2(x));
        assert!(to_y.iter().chain(&to_x).all(|g| g.is_nan()));
    }

    #[test]
    #[should_panic(expected = "atan2: operands must have equal shapes, got [1, 1, 1, 2] and [1, 2, 1, 1]")]
    fn different_shapes_are_refused() {
        let tape = Tape::new();
        tape.leaf(row(&[1.0, 2.0])).atan2(tape.leaf(Tensor::zeros(Shape::new(1, 2, 1, 1))));
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), seed in any::<u64>()) {
            let y = random_away(seed, shape, -2.0, 2.0, &[0.0]);
            let x = random_away(seed ^ 1, shape, -2.0, 2.0, &[0.0]);
            let gap = |v: &Tensor<f64>| Tensor::from_vec(shape, v.data().iter().map(|v| v + 0.2_f64.copysign(*v)).collect());
            testing::check(&[gap(&y), gap(&x)], |v| v[0].atan2(v[1]));
        }
    }
}
