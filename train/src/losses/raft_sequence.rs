//! Supervised loss of a sequence of flow predictions, later ones weighted more.
//!
//! **Formula**: `L = sum_i gamma^(N-1-i) mean(V |F_i - F|)` with the mean over all elements, also those that do not count, and
//! `V` = valid and `|F| < 400` pixels [princeton-vl/RAFT, `train.py`].

use dimode_autodiff::{Scalar, Tensor, Var};

/// Weight ratio of successive predictions; RAFT's fine-tuning on Sintel and KITTI takes 0.85.
pub const GAMMA: f64 = 0.8;
/// Larger displacements (pixels) do not count.
pub const LARGEST: f64 = 400.0;

/// Loss of predictions `[n, 2, h, w]` in pixels against `truth` of the same shape; `valid` is `[n, 1, h, w]`, 0 or 1.
///
/// # Panics
/// When there is no prediction or shapes differ.
#[track_caller]
pub fn raft_sequence<'t, T: Scalar>(predictions: &[Var<'t, T>], truth: &Tensor<T>, valid: &Tensor<T>) -> Var<'t, T> {
    raft_sequence_with(predictions, truth, valid, GAMMA)
}

/// [`raft_sequence`] with another ratio of weights.
///
/// **Gradient**: `gamma^(N-1-i) V sign(F_i - F)` divided by the number of elements; 0 at equal flows, at invalid pixels and
/// where the truth is too large, whatever is stored there.
///
/// # Panics
/// When there is no prediction or shapes differ.
#[track_caller]
pub fn raft_sequence_with<'t, T: Scalar>(
    predictions: &[Var<'t, T>],
    truth: &Tensor<T>,
    valid: &Tensor<T>,
    gamma: f64,
) -> Var<'t, T> {
    let last = *predictions.last().expect("raft_sequence: at least one prediction");
    let tape = last.tape();
    let counts = countable(truth, valid);
    let truth = tape.constant(truth.clone());
    let zero = tape.constant(Tensor::zeros(counts.shape()));
    let mut total = tape.constant(Tensor::scalar(T::ZERO));
    for (i, prediction) in predictions.iter().enumerate() {
        let decay = gamma.powi((predictions.len() - 1 - i) as i32);
        total = total.add(prediction.sub(truth).abs().select(&counts, zero).mean().scale(decay));
    }
    total
}

/// Both components of the pixels that count: valid, with a true flow shorter than [`LARGEST`].
#[track_caller]
fn countable<T: Scalar>(truth: &Tensor<T>, valid: &Tensor<T>) -> Tensor<T> {
    let shape = truth.shape();
    assert!(valid.shape() == shape.with_c(1), "raft_sequence: validity {} does not go with flow {shape}", valid.shape());
    Tensor::from_fn(shape, |n, _, h, w| {
        let (u, v) = (truth.at(n, 0, h, w).to_f64(), truth.at(n, 1, h, w).to_f64());
        if u.hypot(v) < LARGEST && valid.at(n, 0, h, w) != T::ZERO { T::ONE } else { T::ZERO }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::gradcheck::random;
    use dimode_autodiff::{GradCheck, Shape, Tape, gradcheck};

    #[test]
    fn worked_value() {
        let tape = Tape::<f64>::new();
        let shape = Shape::new(1, 2, 1, 2);
        let truth = Tensor::from_vec(shape, vec![1.0, 500.0, 2.0, 0.0]);
        let valid = Tensor::full(Shape::new(1, 1, 1, 2), 1.0);
        let zero = tape.constant(Tensor::zeros(shape));
        let near = tape.constant(Tensor::from_vec(shape, vec![1.5, 0.0, 2.0, 0.0]));
        let l = raft_sequence(&[zero, near], &truth, &valid).value().item();
        // 0.8 * (1 + 2) / 4 + 0.5 / 4, the second pixel is too large to count
        assert!((l - (0.6 + 0.125)).abs() < 1e-12, "{l}");
        let l = raft_sequence_with(&[zero, near], &truth, &valid, 0.5).value().item();
        assert!((l - (0.375 + 0.125)).abs() < 1e-12, "{l}");
    }

    #[test]
    fn what_does_not_count_may_be_nan_and_gets_no_gradient() {
        let tape = Tape::<f64>::new();
        let shape = Shape::new(1, 2, 1, 3);
        let truth = Tensor::from_vec(shape, vec![1.0, f64::NAN, 400.0, 1.0, 0.0, 0.0]);
        let valid = Tensor::from_vec(Shape::new(1, 1, 1, 3), vec![1.0, 0.0, 1.0]);
        let prediction = tape.leaf(Tensor::zeros(shape));
        let loss = raft_sequence(&[prediction], &truth, &valid);
        assert_eq!(loss.value().item(), 2.0 / 6.0);
        assert_eq!(tape.backward(loss).wrt(prediction).data(), [-1.0 / 6.0, 0.0, 0.0, -1.0 / 6.0, 0.0, 0.0]);
    }

    #[test]
    fn gradient_matches_finite_differences() {
        let shape = Shape::new(2, 2, 3, 4);
        let truth = random::<f64>(1, shape, 3.0, 4.0);
        let valid = Tensor::from_fn(shape.with_c(1), |n, _, h, w| ((n + h + w) % 2) as f64);
        let inputs = [random(2, shape, -1.0, 1.0), random(3, shape, 5.0, 6.0)];
        gradcheck(&inputs, |_, v| raft_sequence_with(v, &truth, &valid, 0.85), GradCheck::default()).assert_ok();
    }
}
