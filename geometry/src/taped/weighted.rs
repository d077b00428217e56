//! Means and variances over the pixels of a mask, or under weights in [0, 1] such as one minus the probability of motion.
//!
//! Weights are constants: nothing moves a loss by making its own mask smaller.

use dimode_autodiff::{Scalar, Tensor, Var};

/// `sum w x / sum w` of every sample; 0 where all weights are 0.
///
/// **Shapes**: `x` and `weights` (N,C,H,W); result (N,1,1,1). With weights 0 and 1 this is [`Var::masked_mean`], to the bit.
/// **Gradient**: `g w / sum w`; exactly 0 where the weight is 0, whatever `x` holds there. None to the weights.
/// **Panics** when the shapes differ.
#[must_use]
#[track_caller]
pub fn weighted_mean<'t, T: Scalar>(x: Var<'t, T>, weights: &Tensor<T>) -> Var<'t, T> {
    if weights.data().iter().all(|&w| w == T::ZERO || w == T::ONE) {
        return x.masked_mean(weights);
    }
    let tape = x.tape();
    let zero = tape.constant(Tensor::zeros(x.shape()));
    let sum = x.select(weights, zero).mul(tape.constant(weights.clone())).sum_chw();
    let size = x.shape().len() / x.shape().n();
    let inverse = weights.data().chunks_exact(size).map(|w| {
        let total: f64 = w.iter().map(|w| w.to_f64()).sum();
        T::from_f64(if total == 0.0 { 0.0 } else { 1.0 / total })
    });
    sum.mul(tape.constant(Tensor::from_vec(sum.shape(), inverse.collect())))
}

/// `sum w (x - m)^2 / sum w` of every sample with the weighted mean `m`: the population variance when the weights are 0 and 1.
///
/// **Shapes**: as [`weighted_mean`]. **Gradient**: `2 g w (x - m) / sum w`.
/// **Panics** when the shapes differ.
#[must_use]
#[track_caller]
pub fn weighted_variance<'t, T: Scalar>(x: Var<'t, T>, weights: &Tensor<T>) -> Var<'t, T> {
    let centre = weighted_mean(x, weights).broadcast_to(x.shape());
    weighted_mean(x.sub(centre).square(), weights)
}

/// The weights of a static scene under a soft mask of motion: `mask (1 - moving)`.
///
/// **Shapes**: `mask` (N,1,H,W), 0 or 1 or weights; `moving` (N,1,H,W) in [0, 1], 1 = moves by itself; the result (N,1,H,W).
/// **Panics** when the shapes differ.
#[must_use]
#[track_caller]
pub fn still<T: Scalar>(mask: &Tensor<T>, moving: &Tensor<T>) -> Tensor<T> {
    assert!(mask.shape() == moving.shape(), "still: mask {} and motion {} differ", mask.shape(), moving.shape());
    let weight = |(&keep, &moving): (&T, &T)| if keep == T::ZERO { T::ZERO } else { keep * (T::ONE - moving) };
    Tensor::from_vec(mask.shape(), mask.data().iter().zip(moving.data()).map(weight).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::gradcheck::{random, weighted_sum};
    use dimode_autodiff::{GradCheck, Shape, Tape, gradcheck};

    const SHAPE: Shape = Shape([2, 1, 3, 4]);

    #[test]
    fn worked_mean_and_variance_also_without_weight() {
        let tape = Tape::<f64>::new();
        let shape = Shape::new(2, 1, 1, 3);
        let x = tape.leaf(Tensor::from_vec(shape, vec![1.0, 3.0, f64::NAN, 5.0, 6.0, 7.0]));
        let weights = Tensor::from_vec(shape, vec![0.5, 0.25, 0.0, 0.0, 0.0, 0.0]);
        let (mean, variance) = (weighted_mean(x, &weights), weighted_variance(x, &weights));
        let (third, two_ninths) = (1.0 / 3.0, 2.0 / 9.0);
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-15, "{a} {b}");
        close(mean.value().data()[0], 1.0 + 2.0 * third);
        close(variance.value().data()[0], 4.0 * two_ninths);
        assert_eq!((mean.value().data()[1], variance.value().data()[1]), (0.0, 0.0));
        let grad = tape.backward(mean.sum()).wrt(x);
        close(grad.data()[0], 2.0 * third);
        assert_eq!(grad.data()[2..], [0.0; 4]);
    }

    #[test]
    fn gradients_match_differences() {
        let (x, weights) = (random(1, SHAPE, -1.0, 1.0), random::<f64>(2, SHAPE, 0.0, 1.0));
        gradcheck(std::slice::from_ref(&x), |_, v| weighted_sum(weighted_mean(v[0], &weights), 3), GradCheck::default())
            .assert_ok();
        gradcheck(&[x], |_, v| weighted_sum(weighted_variance(v[0], &weights), 3), GradCheck::default()).assert_ok();
    }

    #[test]
    fn zeros_and_ones_are_a_mask_and_a_common_factor_does_not_matter() {
        let tape = Tape::<f64>::new();
        let x = tape.constant(random(1, SHAPE, -1.0, 1.0));
        let mask = Tensor::from_fn(SHAPE, |n, _, h, w| ((n + h * w) % 2) as f64);
        assert_eq!(weighted_mean(x, &mask).value(), x.masked_mean(&mask).value());
        let third = Tensor::from_vec(SHAPE, mask.data().iter().map(|m| m / 3.0).collect());
        for (a, b) in weighted_variance(x, &third).value().data().iter().zip(weighted_variance(x, &mask).value().data()) {
            assert!((a - b).abs() < 1e-15);
        }
    }

    #[test]
    fn what_moves_weighs_less() {
        let shape = Shape::new(1, 1, 1, 4);
        let mask = Tensor::from_vec(shape, vec![1.0, 1.0, 0.5, 0.0]);
        let moving = Tensor::from_vec(shape, vec![0.25, 1.0, 0.5, f64::NAN]);
        assert_eq!(still(&mask, &moving).data(), [0.75, 0.0, 0.25, 0.0]);
    }
}
