//! `y = a - b`, entry by entry. Vector-Jacobian products: `g` to `a`, `-g` to `b`. Linear. Keeps: nothing.

use super::{binary, kernel};
use crate::proof::{Draw, Number, Plain, Proof, Twin};
use crate::shape::assert_same;
use crate::{GradSink, Scalar, Tensor, Var};

fn forward<T: Scalar>(a: &[T], b: &[T], y: &mut [T]) {
    kernel::zip(y, a, b, |a, b| a - b);
}

fn backward_b<T: Scalar>(grad_y: &[T], grad_b: &mut [T]) {
    kernel::map(grad_b, grad_y, |g| -g);
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Difference of two tensors of one shape; also written `a - b`.
    ///
    /// **Gradient**: `g` to `self`, `-g` to `other`.
    ///
    /// **Panics** when the shapes differ.
    #[track_caller]
    #[allow(clippy::should_implement_trait)] // implemented below; the method needs no import
    pub fn sub(self, other: Var<'t, T>) -> Var<'t, T> {
        assert_same("sub", self.shape(), other.shape());
        let y = binary::output(self, other, forward);
        let record = |g: &Tensor<T>, grads: &mut GradSink<'_, T>| {
            if let Some(mut slot) = grads.slot(0) {
                slot.add_tensor(g);
            }
            if let Some(mut slot) = grads.slot(1) {
                slot.write(|out| backward_b(g.data(), out));
            }
        };
        self.tape().push("sub", y, &[self, other], record)
    }
}

impl<'t, T: Scalar> std::ops::Sub for Var<'t, T> {
    type Output = Var<'t, T>;

    #[track_caller]
    fn sub(self, other: Var<'t, T>) -> Var<'t, T> {
        Var::sub(self, other)
    }
}

#[derive(Clone, Copy, Debug)]
struct Sub;

impl Twin for Sub {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].sub(v[1])
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        x[0].zip(&x[1], |a, b| a - b)
    }
}

pub(crate) fn proof() -> Proof {
    Proof::binary("sub", Sub, |draw: &mut Draw, shape| [draw.uniform(shape, -2.0, 2.0), draw.uniform(shape, -2.0, 2.0)])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random, slopes, slopes2, values2};
    use crate::{Shape, Tape, Tensor};

    #[test]
    fn values_and_slopes_are_known() {
        let (a, b) = ([1.0, -2.0], [10.0, 20.0]);
        close(&values2(&a, &b, |a, b| a.sub(b)), &[-9.0, -22.0]);
        close(&values2(&a, &b, |a, b| a - b), &[-9.0, -22.0]);
        let (to_a, to_b) = slopes2(&a, &b, |a, b| a - b);
        close(&to_a, &[1.0, 1.0]);
        close(&to_b, &[-1.0, -1.0]);
    }

    #[test]
    fn same_variable_twice_collects_both_gradients() {
        close(&slopes(&[3.0], |x| x - x), &[1.0 + -1.0]);
    }

    #[test]
    #[should_panic(expected = "sub: operands must have equal shapes, got [1, 2, 3, 4] and [1, 2, 4, 3]")]
    fn different_shapes_are_refused() {
        let tape = Tape::<f64>::new();
        let a = tape.leaf(Tensor::zeros(Shape::new(1, 2, 3, 4)));
        let b = tape.leaf(Tensor::zeros(Shape::new(1, 2, 4, 3)));
        a.sub(b);
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), seed in any::<u64>()) {
            let (a, b) = (random(seed, shape, -2.0, 2.0), random(seed ^ 1, shape, -2.0, 2.0));
            testing::check(&[a, b], |v| v[0].sub(v[1]));
        }

        #[test]
        fn adjoint_law_holds_in_each_operand(shape in testing::shapes(), seed in any::<u64>()) {
            testing::check_adjoint(shape, seed, |x| x.sub(x.tape().constant(Tensor::zeros(shape))));
            testing::check_adjoint(shape, seed, |x| x.tape().constant(Tensor::zeros(shape)).sub(x));
        }
    }
}
