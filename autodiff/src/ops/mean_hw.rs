//! `y[n, c] = (Σ over h, w of x) / (h w)`: the mean of each plane. Vector-Jacobian product: `g[n, c] / (h w)` to every entry
//! of the plane. Linear. Keeps: nothing. Sums are taken in `f64` in a fixed order.

use super::reduce;
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, shapes};
use crate::{Scalar, Var};

impl<'t, T: Scalar> Var<'t, T> {
    /// Mean of every plane, shape `[n, c, 1, 1]`.
    ///
    /// **Gradient**: `g / (h w)` to every entry of the plane.
    pub fn mean_hw(self) -> Var<'t, T> {
        let shape = self.shape();
        reduce::record("mean_hw", self, shape.with_plane(1, 1), shape.plane() as f64)
    }
}

#[derive(Clone, Copy, Debug)]
struct MeanHw;

impl Twin for MeanHw {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].mean_hw()
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let to = x[0].shape.with_plane(1, 1);
        let terms = x[0].shape.len() as f64 / to.len() as f64;
        x[0].summed(to).map(|sum| sum / N::constant(terms))
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("mean_hw");
    let shapes = shapes(&mut draw);
    Proof::new("mean_hw", shapes.into_iter().map(|shape| Case::new(MeanHw, [draw.uniform(shape, -2.0, 2.0)])))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random};
    use crate::{Shape, Tape, Tensor};

    #[test]
    fn values_and_gradient_are_known() {
        let tape = Tape::new();
        let x = tape.leaf(Tensor::from_fn(Shape::new(2, 3, 1, 2), |n, c, _, w| (100 * n + 10 * c + w) as f64));
        let y = x.mean_hw();
        assert_eq!(y.shape(), Shape::new(2, 3, 1, 1));
        close(y.value().data(), &[0.5, 10.5, 20.5, 100.5, 110.5, 120.5]);
        let weights = tape.constant(Tensor::from_vec(y.shape(), vec![2.0, 4.0, 6.0, 8.0, 10.0, 12.0]));
        close(tape.backward(y.mul(weights).sum()).wrt(x).data(), &[1.0, 1.0, 2.0, 2.0, 3.0, 3.0, 4.0, 4.0, 5.0, 5.0, 6.0, 6.0]);
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), seed in any::<u64>()) {
            testing::check(&[random(seed, shape, -2.0, 2.0)], |v| v[0].mean_hw());
        }

        #[test]
        fn adjoint_law_holds(shape in testing::shapes(), seed in any::<u64>()) {
            testing::check_adjoint(shape, seed, |x| x.mean_hw());
        }
    }
}
