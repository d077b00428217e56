//! Holds the free scale of monocular training: `(ln mean(d) - ln target)^2` over the disparities of a batch.
//!
//! Photometric and geometric losses do not change when depths and translations are multiplied by one number, so the term is free
//! of conflict with them. Without it the scale drifts until the disparity's sigmoid saturates, and depth stops learning.

use dimode_autodiff::{Scalar, Var};

/// Squared log ratio of the mean of positive disparities `[n, 1, h, w]` to `target`.
pub fn scale_anchor<'t, T: Scalar>(disparity: Var<'t, T>, target: f64) -> Var<'t, T> {
    disparity.mean().ln().add_scalar(-target.ln()).square()
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::gradcheck::random;
    use dimode_autodiff::{GradCheck, Shape, Tape, Tensor, gradcheck};

    #[test]
    fn is_zero_at_the_target_and_grows_with_the_log_ratio() {
        let tape = Tape::<f64>::new();
        let at = |d: f64| scale_anchor(tape.constant(Tensor::full(Shape::new(2, 1, 3, 4), d)), 0.2).value().item();
        assert!(at(0.2) < 1e-20);
        assert!((at(0.4) - 2.0_f64.ln().powi(2)).abs() < 1e-12);
        assert!((at(0.4) - at(0.1)).abs() < 1e-12);
    }

    #[test]
    fn gradient_matches_finite_differences() {
        let d = random(1, Shape::new(2, 1, 3, 4), 0.1, 0.9);
        gradcheck(&[d], |_, v| scale_anchor(v[0], 0.2), GradCheck::default()).assert_ok();
    }
}
