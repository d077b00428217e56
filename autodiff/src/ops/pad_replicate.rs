//! Padding of every plane with copies of its edge.
//!
//! `y[i, j] = x[r(i - top), r(j - left)]`, where `r` clamps to `0 ..= H - 1` and `0 ..= W - 1`.
//! Vector-Jacobian product: the transposed gather, `gx[r(i - top), r(j - left)] += g[i, j]`. Linear. Keeps: nothing.

use super::pad::{self, Edge, Sides};
use crate::proof::Proof;
use crate::{Scalar, Var};

impl<'t, T: Scalar> Var<'t, T> {
    /// Pads every plane on each side with copies of the edge element; the amounts may exceed the plane.
    ///
    /// **Shapes**: `[n, c, h, w]` to `[n, c, h + top + bottom, w + left + right]`; a number means all four sides.
    ///
    /// **Gradient**: sums over all copies of an element.
    ///
    /// Equals PyTorch's `pad(mode="replicate")`.
    #[track_caller]
    pub fn pad_replicate(self, sides: impl Into<Sides>) -> Var<'t, T> {
        pad::record_edge("pad_replicate", self, sides.into(), Edge::Replicate)
    }
}

pub(crate) fn proof() -> Proof {
    pad::proof_of("pad_replicate", Some(Edge::Replicate))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::Tape;
    use crate::ops::pad::{Sides, testing::sides};
    use crate::ops::planes::testing::{noise, tensor};
    use crate::ops::testing::{self, close, random};

    #[test]
    fn the_edge_is_repeated() {
        let tape = Tape::new();
        let x = tape.constant(tensor([1, 1, 1, 3], &[1.0, 2.0, 3.0]));
        close(x.pad_replicate(2).value().data(), &[[1.0, 1.0, 1.0, 2.0, 3.0, 3.0, 3.0]; 5].concat());
    }

    #[test]
    fn each_side_has_its_own_amount() {
        let tape = Tape::new();
        let x = tape.constant(tensor([1, 1, 2, 2], &[1.0, 2.0, 3.0, 4.0]));
        let y = x.pad_replicate(Sides { bottom: 2, right: 1, ..Sides::default() }).value();
        close(y.data(), &[1.0, 2.0, 2.0, 3.0, 4.0, 4.0, 3.0, 4.0, 4.0, 3.0, 4.0, 4.0]);
    }

    #[test]
    fn gradient_counts_the_copies() {
        let tape = Tape::new();
        let x = tape.leaf(noise(1, [1, 1, 2, 3]));
        close(tape.backward(x.pad_replicate(1).sum()).wrt(x).data(), &[4.0, 2.0, 4.0, 4.0, 2.0, 4.0]);
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn adjoint_law_holds(shape in testing::shapes(), sides in sides(4), seed in any::<u64>()) {
            testing::check_adjoint(shape, seed, |x| x.pad_replicate(sides));
        }

        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), sides in sides(4), seed in any::<u64>()) {
            testing::check(&[random(seed, shape, -1.0, 1.0)], |v| v[0].pad_replicate(sides));
        }
    }
}
