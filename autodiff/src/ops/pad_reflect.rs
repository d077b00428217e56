//! Padding of every plane with its mirror image.
//!
//! `y[i, j] = x[r(i - top), r(j - left)]`, where `r(-a) = a` and `r(H - 1 + a) = H - 1 - a`: the edge itself is not repeated.
//! Vector-Jacobian product: the transposed gather, `gx[r(i - top), r(j - left)] += g[i, j]`. Linear. Keeps: nothing.

use super::pad::{self, Edge, Sides};
use crate::proof::Proof;
use crate::{Scalar, Var};

impl<'t, T: Scalar> Var<'t, T> {
    /// Pads every plane on each side, mirrored about the edge element (which is not repeated).
    ///
    /// **Shapes**: `[n, c, h, w]` to `[n, c, h + top + bottom, w + left + right]`; a number means all four sides.
    ///
    /// **Gradient**: sums over all copies of an element.
    ///
    /// **Panics** unless the amounts are smaller than the height and the width. Equals PyTorch's `pad(mode="reflect")`.
    #[track_caller]
    pub fn pad_reflect(self, sides: impl Into<Sides>) -> Var<'t, T> {
        let (shape, sides) = (self.shape(), sides.into());
        let (rows, columns) = sides.largest();
        assert!(
            rows < shape.h() && columns < shape.w(),
            "pad_reflect: input {shape}, {rows} rows and {columns} columns; the rule: fewer than height and width"
        );
        pad::record_edge("pad_reflect", self, sides, Edge::Reflect)
    }
}

pub(crate) fn proof() -> Proof {
    pad::proof_of("pad_reflect", Some(Edge::Reflect))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::Tape;
    use crate::ops::pad::{Sides, testing::sides};
    use crate::ops::planes::testing::{noise, tensor};
    use crate::ops::testing::{self, close, random};

    #[test]
    fn the_edge_is_not_repeated() {
        let tape = Tape::new();
        let x = tape.constant(tensor([1, 1, 2, 3], &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]));
        let top = [2.0, 1.0, 2.0, 3.0, 2.0];
        let bottom = [5.0, 4.0, 5.0, 6.0, 5.0];
        close(x.pad_reflect(1).value().data(), &[bottom, top, bottom, top].concat());
    }

    #[test]
    fn each_side_has_its_own_amount() {
        let tape = Tape::new();
        let x = tape.constant(tensor([1, 1, 2, 3], &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]));
        let y = x.pad_reflect(Sides { bottom: 1, left: 2, ..Sides::default() }).value();
        let top = [3.0, 2.0, 1.0, 2.0, 3.0];
        close(y.data(), &[top, [6.0, 5.0, 4.0, 5.0, 6.0], top].concat());
    }

    #[test]
    fn gradient_counts_the_copies() {
        let tape = Tape::new();
        let x = tape.leaf(noise(1, [1, 1, 2, 3]));
        close(tape.backward(x.pad_reflect(1).sum()).wrt(x).data(), &[2.0, 6.0, 2.0, 2.0, 6.0, 2.0]);
    }

    #[test]
    #[should_panic(expected = "pad_reflect: input [1, 1, 3, 2], 2 rows and 2 columns; the rule: fewer than height and width")]
    fn padding_as_wide_as_the_plane_is_refused() {
        Tape::new().constant(noise(1, [1, 1, 3, 2])).pad_reflect(2);
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn adjoint_law_holds(shape in testing::shapes(), h in 3..6usize, w in 3..6usize, sides in sides(3), seed in any::<u64>()) {
            testing::check_adjoint(shape.with_plane(h, w), seed, |x| x.pad_reflect(sides));
        }

        #[test]
        fn gradient_matches_finite_differences(
            shape in testing::shapes(), h in 3..6usize, w in 3..6usize, sides in sides(3), seed in any::<u64>()
        ) {
            testing::check(&[random(seed, shape.with_plane(h, w), -1.0, 1.0)], |v| v[0].pad_reflect(sides));
        }
    }
}
