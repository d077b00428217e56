//! Absolute values and lengths with an optional rounded tip.
//!
//! `sqrt(x^2 + eps^2) - eps`: quadratic below `eps`, the plain value (minus `eps`) above. With `eps = 0` it is
//! the plain absolute value or length. The gradient at zero is zero in every case.

use dimode_autodiff::ops::kernel;
use dimode_autodiff::{GradSink, Scalar, Tensor, Var};

/// `sqrt(x^2 + eps^2) - eps`, entry by entry.
///
/// **Gradient**: `g x / sqrt(x^2 + eps^2)`, 0 at `x = 0`, and 0 where `g = 0` whatever `x` is.
#[track_caller]
pub fn soft_abs<T: Scalar>(x: Var<'_, T>, eps: f64) -> Var<'_, T> {
    let (tip, value) = (T::from_f64(eps), x.value());
    let mut y = x.tape().scratch(value.shape().len());
    kernel::map(&mut y, value.data(), |x| (x * x + tip * tip).sqrt() - tip);
    let y = x.tape().tensor(value.shape(), y);
    let record = move |g: &Tensor<T>, grads: &mut GradSink<'_, T>| {
        if let Some(mut slot) = grads.slot(0) {
            slot.write(|out| {
                kernel::zip(out, value.data(), g.data(), |x, g| {
                    if x == T::ZERO || g == T::ZERO { T::ZERO } else { g * x / (x * x + tip * tip).sqrt() }
                });
            });
        }
    };
    x.tape().push("soft_abs", y, &[x], record)
}

/// `sqrt(x^2 + y^2 + eps^2) - eps`, entry by entry, of two tensors of one shape.
///
/// **Gradient**: `g x / l`, `g y / l` with the length `l` before `eps` comes off; 0 where `l = 0`, and where `g = 0` whatever
/// stands there.
/// **Panics** when the shapes differ.
#[track_caller]
pub fn length<'t, T: Scalar>(x: Var<'t, T>, y: Var<'t, T>, eps: f64) -> Var<'t, T> {
    assert!(x.shape() == y.shape(), "length: shapes {} and {} differ", x.shape(), y.shape());
    let tip = T::from_f64(eps);
    let (a, b) = (x.value(), y.value());
    let mut out = x.tape().scratch(a.shape().len());
    kernel::zip(&mut out, a.data(), b.data(), |x, y| (x * x + y * y + tip * tip).sqrt() - tip);
    let out = x.tape().tensor(a.shape(), out);
    let saved = out.clone();
    let record = move |g: &Tensor<T>, grads: &mut GradSink<'_, T>| {
        for (k, part) in [&a, &b].into_iter().enumerate() {
            if let Some(mut slot) = grads.slot(k) {
                slot.write(|grad| {
                    kernel::zip3(grad, part.data(), saved.data(), g.data(), |x, l, g| {
                        if x == T::ZERO || g == T::ZERO { T::ZERO } else { g * x / (l + tip) }
                    });
                });
            }
        }
    };
    x.tape().push("length", out, &[x, y], record)
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::gradcheck::{random, weighted_sum};
    use dimode_autodiff::{GradCheck, Shape, Tape, gradcheck};

    #[test]
    fn known_values_and_zero_gradient_at_zero() {
        let tape = Tape::<f64>::new();
        let shape = Shape::new(1, 1, 1, 2);
        let x = tape.leaf(Tensor::from_vec(shape, vec![3.0, 0.0]));
        let y = tape.leaf(Tensor::from_vec(shape, vec![-4.0, 0.0]));
        let l = length(x, y, 0.0);
        assert_eq!(l.value().data(), [5.0, 0.0]);
        let grads = tape.backward(l.sum());
        assert_eq!((grads.wrt(x).to_vec(), grads.wrt(y).to_vec()), (vec![0.6, 0.0], vec![-0.8, 0.0]));
        let s = soft_abs(x, 4.0);
        assert_eq!(s.value().data(), [1.0, 0.0]);
        assert_eq!(tape.backward(s.sum()).wrt(x).to_vec(), [0.6, 0.0]);
    }

    #[test]
    fn entries_that_no_one_uses_may_be_anything() {
        let tape = Tape::<f64>::new();
        let shape = Shape::new(1, 1, 1, 3);
        let x = tape.leaf(Tensor::from_vec(shape, vec![f64::NAN, f64::INFINITY, 3.0]));
        let y = tape.leaf(Tensor::from_vec(shape, vec![1.0, 2.0, 4.0]));
        let used = Tensor::from_vec(shape, vec![0.0, 0.0, 1.0]);
        let grads = tape.backward(length(x, y, 0.0).add(soft_abs(x, 4.0)).masked_mean(&used));
        assert!((grads.wrt(x).data()[2] - 1.2).abs() < 1e-15 && (grads.wrt(y).data()[2] - 0.8).abs() < 1e-15);
        assert_eq!((&grads.wrt(x).data()[..2], &grads.wrt(y).data()[..2]), (&[0.0; 2][..], &[0.0; 2][..]));
    }

    #[test]
    fn gradients_match_differences() {
        let shape = Shape::new(2, 1, 3, 5);
        let inputs = [random(1, shape, 0.5, 2.0), random(2, shape, -2.0, -0.5)];
        for eps in [0.0, 0.7] {
            gradcheck(&inputs, |_, v| weighted_sum(length(v[0], v[1], eps), 3), GradCheck::default()).assert_ok();
            gradcheck(&inputs[1..], |_, v| weighted_sum(soft_abs(v[0], eps), 3), GradCheck::default()).assert_ok();
        }
    }
}
