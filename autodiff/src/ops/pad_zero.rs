//! Padding of every plane with zeros.
//!
//! `y[i, j] = x[i - top, j - left]` inside the plane, else 0. Vector-Jacobian product: the part of `g` inside the plane.
//! Linear. Keeps: nothing.

use super::pad::{self, Sides};
use crate::proof::Proof;
use crate::{Scalar, Var};

fn forward_plane<T: Scalar>(x: &[T], y: &mut [T], width: usize, sides: Sides) {
    let padded = sides.left + width + sides.right;
    y.fill(T::ZERO);
    for (row, out) in x.chunks_exact(width.max(1)).zip(y[sides.top * padded..].chunks_exact_mut(padded)) {
        out[sides.left..][..width].copy_from_slice(row);
    }
}

fn backward_plane<T: Scalar>(g: &[T], gx: &mut [T], width: usize, sides: Sides) {
    let padded = sides.left + width + sides.right;
    for (row, out) in g[sides.top * padded..].chunks_exact(padded).zip(gx.chunks_exact_mut(width)) {
        out.copy_from_slice(&row[sides.left..][..width]);
    }
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Pads every plane on each side with zeros.
    ///
    /// **Shapes**: `[n, c, h, w]` to `[n, c, h + top + bottom, w + left + right]`; a number means all four sides.
    ///
    /// **Gradient**: the part of `g` inside the plane. Equals PyTorch's `pad(mode="constant")` with the value 0.
    pub fn pad_zero(self, sides: impl Into<Sides>) -> Var<'t, T> {
        let (width, sides) = (self.shape().w(), sides.into());
        pad::record(
            "pad_zero",
            self,
            sides,
            move |x, y| forward_plane(x, y, width, sides),
            move |g, gx| backward_plane(g, gx, width, sides),
        )
    }
}

pub(crate) fn proof() -> Proof {
    pad::proof_of("pad_zero", None)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::pad::{Sides, testing::sides};
    use crate::ops::planes::testing::tensor;
    use crate::ops::testing::{self, close, random};
    use crate::{Shape, Tape, Tensor};

    #[test]
    fn values_and_gradient_are_known() {
        let tape = Tape::new();
        let x = tape.leaf(tensor([1, 1, 2, 2], &[1.0, 2.0, 3.0, 4.0]));
        let y = x.pad_zero(Sides { top: 1, right: 2, ..Sides::default() });
        close(y.value().data(), &[0.0, 0.0, 0.0, 0.0, 1.0, 2.0, 0.0, 0.0, 3.0, 4.0, 0.0, 0.0]);
        let weights = tape.constant(Tensor::from_fn(y.shape(), |_, _, h, w| (10 * h + w) as f64));
        close(tape.backward(y.mul(weights).sum()).wrt(x).data(), &[10.0, 11.0, 20.0, 21.0]);
    }

    #[test]
    fn a_number_pads_all_sides() {
        let tape = Tape::<f64>::new();
        let y = tape.constant(Tensor::full(Shape::new(2, 1, 1, 1), 5.0)).pad_zero(1).value();
        close(y.data(), &[[0.0, 0.0, 0.0, 0.0, 5.0, 0.0, 0.0, 0.0, 0.0]; 2].concat());
    }

    #[test]
    fn nan_stays_in_its_place() {
        let tape = Tape::new();
        let y = tape.constant(tensor([1, 1, 1, 1], &[f64::NAN])).pad_zero(Sides { left: 1, ..Sides::default() }).value();
        assert!(y.data()[0] == 0.0 && y.data()[1].is_nan());
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn adjoint_law_holds(shape in testing::shapes(), sides in sides(4), seed in any::<u64>()) {
            testing::check_adjoint(shape, seed, |x| x.pad_zero(sides));
        }

        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), sides in sides(4), seed in any::<u64>()) {
            testing::check(&[random(seed, shape, -1.0, 1.0)], |v| v[0].pad_zero(sides));
        }

        #[test]
        fn slices_of_the_result_are_the_operand(shape in testing::shapes(), sides in sides(4), seed in any::<u64>()) {
            let tape = Tape::<f64>::new();
            let x = tape.constant(random(seed, shape, -1.0, 1.0));
            let inside = x.pad_zero(sides).slice(2, sides.top, shape.h()).slice(3, sides.left, shape.w());
            prop_assert_eq!(inside.value(), x.value());
        }
    }
}
