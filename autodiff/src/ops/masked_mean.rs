//! `y[n] = (Σ x over the chosen entries of sample n) / max(count, 1)`, chosen where the mask is not 0.
//! Vector-Jacobian product: `g[n] / max(count, 1)` to the chosen entries, exactly 0 to the others. Linear.
//! Keeps: the mask and the counts; the mask takes no gradient.
//!
//! A sample without chosen entries has mean 0 and gradient 0. Entries that are not chosen may be NaN or infinite: they
//! reach neither the value nor the gradient of this operation. Sums are taken in `f64` in a fixed order.

use super::kernel;
use super::reduce::masked_lane_sum;
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, indices, shapes};
use crate::shape::assert_same;
use crate::{GradSink, Scalar, Shape, Tensor, Var, par};

fn forward<T: Scalar>(x: &[T], mask: &[T], divisor: f64) -> T {
    T::from_f64(par::sum(x.len(), |piece| masked_lane_sum(&x[piece.clone()], &mask[piece])) / divisor)
}

fn backward<T: Scalar>(mask: &[T], divisor: f64, grad_y: T, grad_x: &mut [T]) {
    let share = T::from_f64(grad_y.to_f64() / divisor);
    kernel::map(grad_x, mask, |m| if m == T::ZERO { T::ZERO } else { share });
}

/// `max(count, 1)` of the entries that are not 0.
fn divisor<T: Scalar>(mask: &[T]) -> f64 {
    par::sum(mask.len(), |piece| mask[piece].iter().filter(|&&m| m != T::ZERO).count() as f64).max(1.0)
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Mean of the entries of every sample where `mask` (of the same shape) is not 0; shape `[n, 1, 1, 1]`.
    ///
    /// **Gradient**: `g / max(count, 1)` to the chosen entries, 0 to the others; none to the mask.
    ///
    /// **Panics** when the shapes differ.
    #[track_caller]
    pub fn masked_mean(self, mask: &Tensor<T>) -> Var<'t, T> {
        let shape = self.shape();
        assert_same("masked_mean (mask)", shape, mask.shape());
        let size = shape.len() / shape.n();
        let (x, mask) = (self.value(), mask.clone());
        let divisors: Vec<f64> = mask.data().chunks_exact(size).map(divisor).collect();
        let samples = x.data().chunks_exact(size).zip(mask.data().chunks_exact(size));
        let y = samples.zip(&divisors).map(|((x, mask), &divisor)| forward(x, mask, divisor)).collect();
        let y = Tensor::from_vec(Shape::new(shape.n(), 1, 1, 1), y);
        self.tape().push("masked_mean", y, &[self], move |g: &Tensor<T>, grads: &mut GradSink<'_, T>| {
            if let Some(mut slot) = grads.slot(0) {
                slot.write(|out| {
                    let samples = out.chunks_exact_mut(size).zip(mask.data().chunks_exact(size));
                    for ((out, mask), (&divisor, &g)) in samples.zip(divisors.iter().zip(g.data())) {
                        backward(mask, divisor, g, out);
                    }
                });
            }
        })
    }
}

#[derive(Clone, Copy, Debug)]
struct MaskedMean;

impl Twin for MaskedMean {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].masked_mean(&v[1].value())
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let shape = x[0].shape;
        Plain::from_fn(Shape::new(shape.n(), 1, 1, 1), |[n, ..]| {
            let (mut sum, mut count) = (N::zero(), 0.0_f64);
            for i in indices(shape).filter(|i| i[0] == n && x[1].at(*i).value() != 0.0) {
                sum = sum + x[0].at(i);
                count += 1.0;
            }
            sum / N::constant(count.max(1.0))
        })
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("masked_mean");
    let mut cases = Vec::new();
    for shape in shapes(&mut draw) {
        let inputs = [draw.uniform(shape, -2.0, 2.0), draw.whole(shape, 2)];
        cases.push(Case::new(MaskedMean, inputs).constant(1));
    }
    let shape = Shape::new(3, 2, 5, 3);
    let second_is_empty = Tensor::from_fn(shape, |n, _, _, w| if n == 1 { 0.0 } else { (w % 2) as f64 });
    cases.push(Case::new(MaskedMean, [draw.uniform(shape, -2.0, 2.0), second_is_empty]).constant(1));
    Proof::new("masked_mean", cases)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random};
    use crate::{Shape, Tape, Tensor};

    #[test]
    fn values_and_gradient_are_known_also_for_an_empty_mask() {
        let tape = Tape::new();
        let shape = Shape::new(2, 1, 1, 3);
        let x = tape.leaf(Tensor::from_vec(shape, vec![1.0, 2.0, 6.0, 7.0, 8.0, 9.0]));
        let y = x.masked_mean(&Tensor::from_vec(shape, vec![1.0, 0.0, 0.5, 0.0, 0.0, 0.0]));
        assert_eq!(y.shape(), Shape::new(2, 1, 1, 1));
        close(y.value().data(), &[3.5, 0.0]);
        close(tape.backward(y.sum()).wrt(x).data(), &[0.5, 0.0, 0.5, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn entries_outside_the_mask_may_be_nan_and_inside_show() {
        let tape = Tape::new();
        let shape = Shape::new(1, 1, 1, 2);
        let x = tape.leaf(Tensor::from_vec(shape, vec![f64::NAN, 3.0]));
        close(x.masked_mean(&Tensor::from_vec(shape, vec![0.0, 1.0])).value().data(), &[3.0]);
        assert!(x.masked_mean(&Tensor::full(shape, 1.0)).value().item().is_nan());
    }

    #[test]
    #[should_panic(expected = "masked_mean (mask): operands must have equal shapes, got [2, 3, 4, 5] and [2, 1, 4, 5]")]
    fn mask_of_another_shape_is_refused() {
        let tape = Tape::<f64>::new();
        tape.leaf(Tensor::zeros(Shape::new(2, 3, 4, 5))).masked_mean(&Tensor::zeros(Shape::new(2, 1, 4, 5)));
    }

    /// About half of the entries, the first one always.
    fn mask(seed: u64, shape: Shape) -> Tensor<f64> {
        let toss = random::<f64>(seed ^ 9, shape, 0.0, 1.0);
        let keep = |(i, x): (usize, &f64)| f64::from(u8::from(i == 0 || *x < 0.5));
        Tensor::from_vec(shape, toss.data().iter().enumerate().map(keep).collect())
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), seed in any::<u64>()) {
            testing::check(&[random(seed, shape, -2.0, 2.0)], |v| v[0].masked_mean(&mask(seed, shape)));
        }

        #[test]
        fn adjoint_law_holds(shape in testing::shapes(), seed in any::<u64>()) {
            testing::check_adjoint(shape, seed, |x| x.masked_mean(&mask(seed, shape)));
        }

        #[test]
        fn full_mask_gives_the_mean(shape in testing::shapes(), seed in any::<u64>()) {
            let tape = Tape::<f64>::new();
            let x = tape.leaf(random(seed, shape, -2.0, 2.0));
            let masked = x.masked_mean(&Tensor::full(shape, 1.0)).mean().value().item();
            prop_assert!((masked - x.mean().value().item()).abs() < 1e-12);
        }
    }
}
