//! `y = a b`, entry by entry. Vector-Jacobian products: `g b` to `a`, `g a` to `b`. No kinks.
//! Keeps: each operand whose partner wants a gradient.

use super::{binary, kernel};
use crate::proof::{Draw, Number, Plain, Proof, Twin};
use crate::shape::assert_same;
use crate::{GradSink, Scalar, Tensor, Var};

fn forward<T: Scalar>(a: &[T], b: &[T], y: &mut [T]) {
    kernel::zip(y, a, b, |a, b| a * b);
}

fn backward<T: Scalar>(partner: &[T], grad_y: &[T], grad: &mut [T]) {
    kernel::zip(grad, partner, grad_y, |partner, g| partner * g);
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Product, entry by entry, of two tensors of one shape; also written `a * b`.
    ///
    /// **Gradient**: `g b` to `self`, `g a` to `other`.
    ///
    /// **Panics** when the shapes differ.
    #[track_caller]
    #[allow(clippy::should_implement_trait)] // implemented below; the method needs no import
    pub fn mul(self, other: Var<'t, T>) -> Var<'t, T> {
        assert_same("mul", self.shape(), other.shape());
        let y = binary::output(self, other, forward);
        let partner_of_a = self.requires_grad().then(|| other.value());
        let partner_of_b = other.requires_grad().then(|| self.value());
        let record = move |g: &Tensor<T>, grads: &mut GradSink<'_, T>| {
            for (parent, partner) in [&partner_of_a, &partner_of_b].into_iter().enumerate() {
                if let (Some(partner), Some(mut slot)) = (partner, grads.slot(parent)) {
                    slot.write(|out| backward(partner.data(), g.data(), out));
                }
            }
        };
        self.tape().push("mul", y, &[self, other], record)
    }
}

impl<'t, T: Scalar> std::ops::Mul for Var<'t, T> {
    type Output = Var<'t, T>;

    #[track_caller]
    fn mul(self, other: Var<'t, T>) -> Var<'t, T> {
        Var::mul(self, other)
    }
}

#[derive(Clone, Copy, Debug)]
struct Mul;

impl Twin for Mul {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].mul(v[1])
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        x[0].zip(&x[1], |a, b| a * b)
    }
}

pub(crate) fn proof() -> Proof {
    Proof::binary("mul", Mul, |draw: &mut Draw, shape| [draw.uniform(shape, -2.0, 2.0), draw.uniform(shape, -2.0, 2.0)])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random, row, slopes, slopes2, values2};
    use crate::{Shape, Tape, Tensor};

    #[test]
    fn values_and_slopes_are_known() {
        let (a, b) = ([1.5, -2.0], [10.0, 0.0]);
        close(&values2(&a, &b, |a, b| a.mul(b)), &[15.0, 0.0]);
        let (to_a, to_b) = slopes2(&a, &b, |a, b| a * b);
        close(&to_a, &b);
        close(&to_b, &a);
    }

    #[test]
    fn product_with_itself_is_the_square() {
        close(&slopes(&[3.0, -1.0], |x| x * x), &[6.0, -2.0]);
    }

    #[test]
    fn constant_operand_gets_no_gradient() {
        let tape = Tape::new();
        let (a, b) = (tape.leaf(row(&[2.0])), tape.constant(row(&[5.0])));
        let grads = tape.backward((a * b).sum());
        close(grads.wrt(a).data(), &[5.0]);
        assert!(grads.get(b).is_none());
    }

    #[test]
    #[should_panic(expected = "mul: operands must have equal shapes, got [1, 1, 1, 2] and [1, 1, 1, 1]")]
    fn nothing_is_broadcast_silently() {
        let tape = Tape::<f64>::new();
        let a = tape.leaf(Tensor::zeros(Shape::new(1, 1, 1, 2)));
        a.mul(tape.leaf(Tensor::scalar(1.0)));
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), seed in any::<u64>()) {
            let (a, b) = (random(seed, shape, -2.0, 2.0), random(seed ^ 1, shape, -2.0, 2.0));
            testing::check(&[a, b], |v| v[0].mul(v[1]));
        }

        #[test]
        fn adjoint_law_holds_for_a_fixed_factor(shape in testing::shapes(), seed in any::<u64>()) {
            let factor = random(seed ^ 2, shape, -2.0, 2.0);
            testing::check_adjoint(shape, seed, |x| x.mul(x.tape().constant(factor.clone())));
        }
    }
}
