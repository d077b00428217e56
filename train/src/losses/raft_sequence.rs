//! Supervised loss of a sequence of flow predictions, later ones weighted more.
//!
//! `L = sum_i gamma^(N-1-i) mean(V |F_i - F|)` with the mean over all elements and `V` = valid and `|F| < 400` pixels.

use dimode_autodiff::{Scalar, Tensor, Var};

/// Weight ratio of successive predictions.
pub const GAMMA: f64 = 0.8;
/// Larger displacements (pixels) do not count.
pub const LARGEST: f64 = 400.0;

/// Loss of predictions `[n, 2, h, w]` in pixels against `truth` of the same shape; `valid` is `[n, 1, h, w]`, 0 or 1.
///
/// # Panics
/// When there is no prediction or shapes differ.
#[track_caller]
pub fn raft_sequence<'t, T: Scalar>(predictions: &[Var<'t, T>], truth: &Tensor<T>, valid: &Tensor<T>) -> Var<'t, T> {
    let last = *predictions.last().expect("raft_sequence: at least one prediction");
    let tape = last.tape();
    let shape = truth.shape();
    let weight = Tensor::from_fn(shape, |n, _, h, w| {
        let (u, v) = (truth.at(n, 0, h, w).to_f64(), truth.at(n, 1, h, w).to_f64());
        if u.hypot(v) < LARGEST { valid.at(n, 0, h, w) } else { T::ZERO }
    });
    let (truth, weight) = (tape.constant(truth.clone()), tape.constant(weight));
    let mut total = tape.constant(Tensor::scalar(T::ZERO));
    for (i, prediction) in predictions.iter().enumerate() {
        let decay = GAMMA.powi((predictions.len() - 1 - i) as i32);
        total = total.add(prediction.sub(truth).abs().mul(weight).mean().scale(decay));
    }
    total
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::{Shape, Tape};

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
    }
}
