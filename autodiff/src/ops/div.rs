//! Quotients of two tensors of one shape, plain and guarded.
//!
//! - `div`: `y = a / b`. Vector-Jacobian products: `g / b` to `a`, `-g y / b` to `b`. Domain: `b ≠ 0`; a zero
//!   denominator gives an infinite value or NaN, which is not hidden.
//! - `div_guarded(eps)`: `y = a / d` with `d = b` where `|b| >= eps`, else `d = eps` with the sign of `b` (plus for
//!   both zeros): the denominator never comes nearer to zero than `eps`, and the value is the plain quotient wherever
//!   the guard is idle. Vector-Jacobian products: `g / d` to `a`, so bounded by `|g| / eps`; `-g y / d` to `b` where
//!   the guard is idle (also at `|b| = eps`), 0 where it acts, as there `d` is constant. NaN stays NaN.
//!
//! Both keep `b`, and the output when `b` wants a gradient.

use super::{binary, kernel};
use crate::proof::{Draw, Number, Plain, Proof, Twin};
use crate::shape::assert_same;
use crate::{GradSink, Scalar, Tensor, Var};

fn forward<T: Scalar>(a: &[T], b: &[T], eps: T, y: &mut [T]) {
    kernel::zip(y, a, b, |a, b| a / guarded(b, eps));
}

fn backward_a<T: Scalar>(b: &[T], eps: T, grad_y: &[T], grad_a: &mut [T]) {
    kernel::zip(grad_a, b, grad_y, |b, g| g / guarded(b, eps));
}

fn backward_b<T: Scalar>(y: &[T], b: &[T], eps: T, grad_y: &[T], grad_b: &mut [T]) {
    kernel::zip3(grad_b, y, b, grad_y, |y, b, g| if b.abs() < eps { T::ZERO } else { -(g * y / b) });
}

/// The denominator after the guard; with `eps` zero it is `b` itself.
#[inline(always)]
fn guarded<T: Scalar>(b: T, eps: T) -> T {
    if b.abs() < eps { if b < T::ZERO { -eps } else { eps } } else { b }
}

#[track_caller]
fn quotient<'t, T: Scalar>(op: &'static str, a: Var<'t, T>, b: Var<'t, T>, eps: T) -> Var<'t, T> {
    assert_same(op, a.shape(), b.shape());
    let y = binary::output(a, b, |a, b, y| forward(a, b, eps, y));
    let denominator = b.value();
    let quotient = b.requires_grad().then(|| y.clone());
    let record = move |g: &Tensor<T>, grads: &mut GradSink<'_, T>| {
        if let Some(mut slot) = grads.slot(0) {
            slot.write(|out| backward_a(denominator.data(), eps, g.data(), out));
        }
        if let (Some(y), Some(mut slot)) = (&quotient, grads.slot(1)) {
            slot.write(|out| backward_b(y.data(), denominator.data(), eps, g.data(), out));
        }
    };
    a.tape().push(op, y, &[a, b], record)
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Plain quotient, entry by entry, of two tensors of one shape; also written `a / b`.
    ///
    /// **Domain**: `b ≠ 0`; see [`Var::div_guarded`] where zero can occur.
    ///
    /// **Gradient**: `g / b` to `self`, `-g a / b²` to `other`.
    ///
    /// **Panics** when the shapes differ.
    #[track_caller]
    #[allow(clippy::should_implement_trait)] // implemented below; the method needs no import
    pub fn div(self, other: Var<'t, T>) -> Var<'t, T> {
        quotient("div", self, other, T::ZERO)
    }

    /// Quotient whose denominator is held at least `eps` away from zero, with its sign kept (zero counts as positive).
    ///
    /// **Gradient**: as of [`Var::div`] with the guarded denominator; 0 to `other` where the guard acts, that is where
    /// `|other| < eps`. Such entries keep the derivative to `self`, bounded by `1 / eps`: mask them when they mean nothing.
    ///
    /// **Panics** when the shapes differ, or unless `eps` is positive and finite in `T`.
    #[track_caller]
    pub fn div_guarded(self, other: Var<'t, T>, eps: f64) -> Var<'t, T> {
        let guard = T::from_f64(eps);
        assert!(
            guard > T::ZERO && guard.is_finite(),
            "div_guarded: eps is {eps}; the rule: positive and finite in the scalar type"
        );
        quotient("div_guarded", self, other, guard)
    }
}

impl<'t, T: Scalar> std::ops::Div for Var<'t, T> {
    type Output = Var<'t, T>;

    #[track_caller]
    fn div(self, other: Var<'t, T>) -> Var<'t, T> {
        Var::div(self, other)
    }
}

#[derive(Clone, Copy, Debug)]
struct Quotient {
    guard: Option<f64>,
}

impl Twin for Quotient {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        match self.guard {
            None => v[0] / v[1],
            Some(eps) => v[0].div_guarded(v[1], eps),
        }
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        x[0].zip(&x[1], |a, b| match self.guard {
            Some(eps) if b.value().abs() < eps => a / N::constant(if b.value() < 0.0 { -eps } else { eps }),
            _ => a / b,
        })
    }
}

pub(crate) fn proof() -> Proof {
    Proof::binary("div", Quotient { guard: None }, |draw: &mut Draw, shape| [draw.uniform(shape, -2.0, 2.0), draw.weights(shape)])
}

pub(crate) fn guarded_proof() -> Proof {
    Proof::binary("div_guarded", Quotient { guard: Some(0.5) }, |draw: &mut Draw, shape| {
        [draw.uniform(shape, -2.0, 2.0), draw.away(shape, -2.0, 2.0, &[-0.5, 0.5])]
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random, random_away, row, slopes2, values2};
    use crate::{Shape, Tape, Tensor};

    #[test]
    fn values_and_slopes_are_known() {
        let (a, b) = ([3.0, -2.0], [2.0, -0.5]);
        close(&values2(&a, &b, |a, b| a / b), &[1.5, 4.0]);
        let (to_a, to_b) = slopes2(&a, &b, |a, b| a / b);
        close(&to_a, &[0.5, -2.0]);
        close(&to_b, &[-0.75, 8.0]);
    }

    #[test]
    fn plain_division_by_zero_is_visible() {
        let y = values2(&[1.0, -1.0, 0.0], &[0.0, 0.0, 0.0], |a, b| a.div(b));
        close(&y[..2], &[f64::INFINITY, f64::NEG_INFINITY]);
        assert!(y[2].is_nan());
    }

    #[test]
    fn guard_keeps_the_sign_and_bounds_the_value() {
        let (a, b) = ([1.0, 1.0, 1.0, 1.0], [0.0, -0.0, -0.01, 0.01]);
        close(&values2(&a, &b, |a, b| a.div_guarded(b, 0.1)), &[10.0, 10.0, -10.0, 10.0]);
        let (to_a, to_b) = slopes2(&a, &b, |a, b| a.div_guarded(b, 0.1));
        close(&to_a, &[10.0, 10.0, -10.0, 10.0]);
        close(&to_b, &[0.0; 4]);
    }

    #[test]
    fn guard_is_idle_from_eps_on() {
        let (a, b) = ([1.0, 1.0], [0.5, -4.0]);
        close(&values2(&a, &b, |a, b| a.div_guarded(b, 0.5)), &[2.0, -0.25]);
        close(&slopes2(&a, &b, |a, b| a.div_guarded(b, 0.5)).1, &[-4.0, -0.0625]);
    }

    #[test]
    fn nan_is_not_hidden_by_the_guard() {
        assert!(values2(&[1.0], &[f64::NAN], |a, b| a.div_guarded(b, 0.1))[0].is_nan());
    }

    #[test]
    #[should_panic(expected = "div_guarded: eps is 0")]
    fn zero_guard_is_refused() {
        values2(&[1.0], &[1.0], |a, b| a.div_guarded(b, 0.0));
    }

    #[test]
    #[should_panic(expected = "div: operands must have equal shapes, got [1, 1, 1, 2] and [2, 1, 1, 1]")]
    fn different_shapes_are_refused() {
        let tape = Tape::new();
        tape.leaf(row(&[1.0, 2.0])).div(tape.leaf(Tensor::zeros(Shape::new(2, 1, 1, 1))));
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), seed in any::<u64>()) {
            let (a, b) = (random(seed, shape, -2.0, 2.0), random(seed ^ 1, shape, 0.5, 2.0));
            testing::check(&[a, b], |v| v[0].div(v[1]));
        }

        #[test]
        fn guarded_gradient_matches_finite_differences(shape in testing::shapes(), seed in any::<u64>()) {
            let a = random(seed, shape, -2.0, 2.0);
            let b = random_away(seed ^ 1, shape, -1.0, 1.0, &[-0.4, 0.0, 0.4]);
            testing::check(&[a, b], |v| v[0].div_guarded(v[1], 0.4));
        }

        #[test]
        fn adjoint_law_holds_in_the_numerator(shape in testing::shapes(), seed in any::<u64>()) {
            let b = random(seed ^ 2, shape, 0.5, 2.0);
            testing::check_adjoint(shape, seed, |x| x.div(x.tape().constant(b.clone())));
        }
    }
}
