//! `y = x` repeated along the axes where `x` has size 1. Vector-Jacobian product: the sum of `g` over those axes, in `f64`
//! and in a fixed order. Linear, the transpose of `sum_to`. Keeps: nothing.
//!
//! This is the only way to combine different shapes: no other operation repeats an operand.

use super::reduce::{assert_goes_with, expand, reduce};
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, some_axes};
use crate::{GradSink, Scalar, Shape, Tensor, Var};

impl<'t, T: Scalar> Var<'t, T> {
    /// Repetition along the axes of size 1 up to `shape`; the other axes must be equal.
    ///
    /// **Gradient**: the sum of `g` over the repeated axes.
    ///
    /// **Panics** when an axis of the operand is neither equal nor 1.
    #[track_caller]
    pub fn broadcast_to(self, shape: Shape) -> Var<'t, T> {
        let small = self.shape();
        assert_goes_with("broadcast_to", small, shape);
        if small == shape {
            return self;
        }
        let mut y = self.tape().scratch(shape.len());
        expand(self.value().data(), small, &mut y, shape, 1.0);
        let y = self.tape().tensor(shape, y);
        self.tape().push("broadcast_to", y, &[self], move |g: &Tensor<T>, grads: &mut GradSink<'_, T>| {
            if let Some(mut slot) = grads.slot(0) {
                slot.write(|out| reduce(g.data(), shape, out, small, 1.0));
            }
        })
    }
}

#[derive(Clone, Copy, Debug)]
struct BroadcastTo(Shape);

impl Twin for BroadcastTo {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].broadcast_to(self.0)
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        Plain::from_fn(self.0, |i| x[0].repeated(i))
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("broadcast_to");
    let pairs = some_axes(&mut draw);
    Proof::new(
        "broadcast_to",
        pairs.into_iter().map(|(large, small)| Case::new(BroadcastTo(large), [draw.uniform(small, -2.0, 2.0)])),
    )
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random};
    use crate::{Shape, Tape, Tensor};

    #[test]
    fn values_and_gradient_are_known() {
        let tape = Tape::new();
        let x = tape.leaf(Tensor::from_vec(Shape::new(1, 2, 1, 1), vec![3.0, 7.0]));
        let y = x.broadcast_to(Shape::new(2, 2, 1, 2));
        close(y.value().data(), &[3.0, 3.0, 7.0, 7.0, 3.0, 3.0, 7.0, 7.0]);
        let weights = tape.constant(Tensor::from_fn(y.shape(), |n, c, _, w| (100 * n + 10 * c + w) as f64));
        close(tape.backward(y.mul(weights).sum()).wrt(x).data(), &[202.0, 242.0]);
    }

    #[test]
    fn rows_and_columns_repeat() {
        let tape = Tape::new();
        let x = tape.leaf(Tensor::from_vec(Shape::new(1, 1, 1, 3), vec![1.0, 2.0, 3.0]));
        close(x.broadcast_to(Shape::new(1, 1, 2, 3)).value().data(), &[1.0, 2.0, 3.0, 1.0, 2.0, 3.0]);
        let x = x.reshape(Shape::new(1, 1, 3, 1));
        close(x.broadcast_to(Shape::new(1, 1, 3, 2)).value().data(), &[1.0, 1.0, 2.0, 2.0, 3.0, 3.0]);
    }

    #[test]
    #[should_panic(expected = "broadcast_to: [1, 3, 2, 1] does not go with [4, 3, 1, 5]")]
    fn neither_equal_nor_one_is_refused() {
        let tape = Tape::<f64>::new();
        tape.leaf(Tensor::zeros(Shape::new(1, 3, 2, 1))).broadcast_to(Shape::new(4, 3, 1, 5));
    }

    fn smaller(shape: Shape, keep: [bool; 4]) -> Shape {
        Shape(std::array::from_fn(|i| if keep[i] { shape.0[i] } else { 1 }))
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), keep in any::<[bool; 4]>(), seed in any::<u64>()) {
            testing::check(&[random(seed, smaller(shape, keep), -2.0, 2.0)], |v| v[0].broadcast_to(shape));
        }

        #[test]
        fn adjoint_law_holds(shape in testing::shapes(), keep in any::<[bool; 4]>(), seed in any::<u64>()) {
            testing::check_adjoint(smaller(shape, keep), seed, |x| x.broadcast_to(shape));
        }
    }
}
