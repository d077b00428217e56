//! `y = a` where the mask is not 0, `b` where it is 0. Vector-Jacobian products: `g` to the chosen operand and exactly 0
//! to the other, whatever it holds. Linear in the operands together. Keeps: the mask, which takes no gradient.
//!
//! The gradient is chosen, not multiplied: an infinite or NaN entry that is not chosen reaches neither the value nor the
//! gradient **of this operation**. An operation before it still computes `0 · ∞`; so select a harmless constant
//! *before* a hazardous operation (division, root, logarithm), not after it. A NaN in the mask counts as not 0.

use super::kernel;
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, shapes};
use crate::shape::assert_same;
use crate::{GradSink, Scalar, Tensor, Var};

fn forward<T: Scalar>(mask: &[T], a: &[T], b: &[T], y: &mut [T]) {
    kernel::zip3(y, mask, a, b, |m, a, b| if m == T::ZERO { b } else { a });
}

fn backward_a<T: Scalar>(mask: &[T], grad_y: &[T], grad_a: &mut [T]) {
    kernel::zip(grad_a, mask, grad_y, |m, g| if m == T::ZERO { T::ZERO } else { g });
}

fn backward_b<T: Scalar>(mask: &[T], grad_y: &[T], grad_b: &mut [T]) {
    kernel::zip(grad_b, mask, grad_y, |m, g| if m == T::ZERO { g } else { T::ZERO });
}

impl<'t, T: Scalar> Var<'t, T> {
    /// `self` where `mask` is not 0, else `other`; all of one shape.
    ///
    /// **Gradient**: `g` to the chosen operand, 0 to the other; none to the mask.
    ///
    /// **Panics** when the shapes differ.
    #[track_caller]
    pub fn select(self, mask: &Tensor<T>, other: Var<'t, T>) -> Var<'t, T> {
        assert_same("select", self.shape(), other.shape());
        assert_same("select (mask)", self.shape(), mask.shape());
        let mut y = self.tape().scratch(self.shape().len());
        forward(mask.data(), self.value().data(), other.value().data(), &mut y);
        let y = self.tape().tensor(self.shape(), y);
        let mask = mask.clone();
        let record = move |g: &Tensor<T>, grads: &mut GradSink<'_, T>| {
            if let Some(mut slot) = grads.slot(0) {
                slot.write(|out| backward_a(mask.data(), g.data(), out));
            }
            if let Some(mut slot) = grads.slot(1) {
                slot.write(|out| backward_b(mask.data(), g.data(), out));
            }
        };
        self.tape().push("select", y, &[self, other], record)
    }
}

#[derive(Clone, Copy, Debug)]
struct Select;

impl Twin for Select {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].select(&v[2].value(), v[1])
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let chosen = x[0].shape;
        Plain::from_fn(chosen, |i| if x[2].at(i).value() != 0.0 { x[0].at(i) } else { x[1].at(i) })
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("select");
    let mut cases = Vec::new();
    for (i, shape) in shapes(&mut draw).into_iter().enumerate() {
        let operands = [draw.uniform(shape, -2.0, 2.0), draw.uniform(shape, -2.0, 2.0), draw.whole(shape, 2)];
        let case = Case::new(Select, operands).constant(2);
        cases.push(match i {
            6 => case.constant(0),
            7 => case.constant(1),
            _ => case,
        });
    }
    Proof::new("select", cases)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random, row, slopes, slopes2, values2};
    use crate::{Shape, Tape, Tensor};

    #[test]
    fn values_and_slopes_are_known() {
        let mask = row(&[1.0, 0.0, -0.5, -0.0]);
        let (a, b) = ([1.0, 2.0, 3.0, 4.0], [10.0, 20.0, 30.0, 40.0]);
        close(&values2(&a, &b, |a, b| a.select(&mask, b)), &[1.0, 20.0, 3.0, 40.0]);
        let (to_a, to_b) = slopes2(&a, &b, |a, b| a.select(&mask, b));
        close(&to_a, &[1.0, 0.0, 1.0, 0.0]);
        close(&to_b, &[0.0, 1.0, 0.0, 1.0]);
    }

    #[test]
    fn chosen_nan_shows_and_other_nan_does_not() {
        let mask = row(&[1.0, 0.0]);
        let y = values2(&[f64::NAN, f64::NAN], &[7.0, 7.0], |a, b| a.select(&mask, b));
        assert!(y[0].is_nan());
        close(&y[1..], &[7.0]);
    }

    #[test]
    fn constant_before_a_hazardous_operation_keeps_the_gradient_finite() {
        let mask = row(&[1.0, 0.0]);
        let safe = slopes(&[4.0, 0.0], |x| x.select(&mask, x.tape().constant(row(&[1.0, 1.0]))).sqrt());
        close(&safe, &[0.25, 0.0]);
        let late = slopes(&[4.0, 0.0], |x| x.sqrt().select(&mask, x.tape().constant(row(&[1.0, 1.0]))));
        assert!(late[1].is_nan());
    }

    #[test]
    #[should_panic(expected = "select (mask): operands must have equal shapes, got [2, 3, 1, 1] and [2, 1, 1, 1]")]
    fn mask_of_another_shape_is_refused() {
        let tape = Tape::<f64>::new();
        let x = tape.leaf(Tensor::zeros(Shape::new(2, 3, 1, 1)));
        x.select(&Tensor::zeros(Shape::new(2, 1, 1, 1)), x);
    }

    fn coin(seed: u64, shape: Shape) -> Tensor<f64> {
        let toss = random::<f64>(seed ^ 9, shape, 0.0, 1.0);
        Tensor::from_vec(shape, toss.data().iter().map(|x| f64::from(u8::from(*x < 0.5))).collect())
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), seed in any::<u64>()) {
            let (a, b) = (random(seed, shape, -2.0, 2.0), random(seed ^ 1, shape, -2.0, 2.0));
            testing::check(&[a, b], |v| v[0].select(&coin(seed, shape), v[1]));
        }

        #[test]
        fn adjoint_law_holds_in_each_operand(shape in testing::shapes(), seed in any::<u64>()) {
            let mask = coin(seed, shape);
            testing::check_adjoint(shape, seed, |x| x.select(&mask, x.tape().constant(Tensor::zeros(shape))));
            testing::check_adjoint(shape, seed, |x| x.tape().constant(Tensor::zeros(shape)).select(&mask, x));
        }
    }
}
