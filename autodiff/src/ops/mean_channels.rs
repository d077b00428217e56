//! `y[n, h, w] = (Σ over c of x) / c`: the mean over channels at each pixel. Vector-Jacobian product: `g[n, h, w] / c` to
//! every channel of the pixel. Linear. Keeps: nothing. Sums are taken in `f64` in the order of the channels.

use super::reduce;
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, shapes};
use crate::{Scalar, Var};

impl<'t, T: Scalar> Var<'t, T> {
    /// Mean over the channels at every pixel, shape `[n, 1, h, w]`.
    ///
    /// **Gradient**: `g / c` to every channel.
    pub fn mean_channels(self) -> Var<'t, T> {
        let shape = self.shape();
        reduce::record("mean_channels", self, shape.with_c(1), shape.c() as f64)
    }
}

#[derive(Clone, Copy, Debug)]
struct MeanChannels;

impl Twin for MeanChannels {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].mean_channels()
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let to = x[0].shape.with_c(1);
        let terms = x[0].shape.len() as f64 / to.len() as f64;
        x[0].summed(to).map(|sum| sum / N::constant(terms))
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("mean_channels");
    let shapes = shapes(&mut draw);
    Proof::new("mean_channels", shapes.into_iter().map(|shape| Case::new(MeanChannels, [draw.uniform(shape, -2.0, 2.0)])))
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
        let y = x.mean_channels();
        assert_eq!(y.shape(), Shape::new(2, 1, 1, 2));
        close(y.value().data(), &[10.0, 11.0, 110.0, 111.0]);
        let weights = tape.constant(Tensor::from_vec(y.shape(), vec![3.0, 6.0, 9.0, 12.0]));
        close(tape.backward(y.mul(weights).sum()).wrt(x).data(), &[1.0, 2.0, 1.0, 2.0, 1.0, 2.0, 3.0, 4.0, 3.0, 4.0, 3.0, 4.0]);
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), seed in any::<u64>()) {
            testing::check(&[random(seed, shape, -2.0, 2.0)], |v| v[0].mean_channels());
        }

        #[test]
        fn adjoint_law_holds(shape in testing::shapes(), seed in any::<u64>()) {
            testing::check_adjoint(shape, seed, |x| x.mean_channels());
        }
    }
}
