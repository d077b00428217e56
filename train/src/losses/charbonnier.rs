//! Charbonnier's penalty: quadratic near zero, a root of the size far away.
//!
//! **Formula**: `(x^2 + eps^2)^alpha`. UnFlow and DF-Net use alpha 0.45 and eps 1e-3; SMURF's robust L1 is alpha 1/2, eps 1e-3
//! [vt-vl-lab/DF-Net, `core/UnFlow/src/e2eflow/core/losses.py`; google-research/google-research, `smurf/`].

use dimode_autodiff::{Scalar, Var};

/// The penalty of every entry, any shape to the same.
///
/// **Gradient**: `2 alpha x (x^2 + eps^2)^(alpha - 1)`, 0 at `x = 0`.
///
/// # Panics
/// Unless `eps` is positive and `alpha` is not 0.
#[track_caller]
pub fn charbonnier<T: Scalar>(x: Var<'_, T>, eps: f64, alpha: f64) -> Var<'_, T> {
    assert!(eps > 0.0, "charbonnier: eps is {eps}; the rule: positive, or the slope at 0 is infinite");
    x.square().add_scalar(eps * eps).powf(alpha)
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::gradcheck::{random, weighted_sum};
    use dimode_autodiff::{GradCheck, Shape, Tape, Tensor, gradcheck};

    #[test]
    fn known_values_and_no_slope_at_zero() {
        let tape = Tape::<f64>::new();
        let x = tape.leaf(Tensor::from_vec(Shape::new(1, 1, 1, 3), vec![0.0, 3.0, -3.0]));
        let y = charbonnier(x, 4.0, 0.5);
        assert_eq!(y.value().data(), [4.0, 5.0, 5.0]);
        let grad = tape.backward(y.sum()).wrt(x);
        assert!(grad.data().iter().zip([0.0, 0.6, -0.6]).all(|(g, e)| (g - e).abs() < 1e-15), "{grad:?}");
        assert_eq!(grad.data()[0], 0.0);
    }

    #[test]
    fn gradient_matches_finite_differences() {
        let x = random(1, Shape::new(1, 2, 3, 4), -1.0, 1.0);
        gradcheck(&[x], |_, v| weighted_sum(charbonnier(v[0], 0.3, 0.45), 2), GradCheck::default()).assert_ok();
    }

    #[test]
    #[should_panic(expected = "charbonnier: eps is 0")]
    fn a_sharp_tip_is_refused() {
        charbonnier(Tape::<f64>::new().leaf(Tensor::scalar(1.0)), 0.0, 0.45);
    }
}
