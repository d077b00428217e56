//! `y = √max(x, floor)` with a floor above 0. Vector-Jacobian product: `g / (2 y)` where `x >= floor`, 0 below; at the kink
//! `x = floor` the gradient passes, as in `clamp`. Keeps: the input.
//!
//! The slope is at most `1 / (2 √floor)`, so a zero argument, whose plain root has an infinite slope, gives the finite value
//! `√floor` and no gradient. A negative argument counts as the floor. NaN stays NaN.

use super::{kernel, unary};
use crate::proof::{Number, Plain, Proof, Twin};
use crate::{Scalar, Var};

fn forward<T: Scalar>(x: &[T], floor: T, y: &mut [T]) {
    kernel::map(y, x, |x| if x < floor { floor.sqrt() } else { x.sqrt() });
}

fn backward<T: Scalar>(x: &[T], floor: T, grad_y: &[T], grad_x: &mut [T]) {
    kernel::zip(grad_x, x, grad_y, |x, g| if x < floor { T::ZERO } else { g * (T::from_f64(0.5) / x.sqrt()) });
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Square root of every entry, entries below `floor` counting as `floor`.
    ///
    /// **Shapes**: any to the same.
    ///
    /// **Gradient**: `g / (2 √x)` where `x >= floor`, 0 below.
    ///
    /// **Panics** unless `floor` is positive and finite in `T`.
    #[track_caller]
    pub fn sqrt_guarded(self, floor: f64) -> Var<'t, T> {
        let guard = T::from_f64(floor);
        assert!(
            guard > T::ZERO && guard.is_finite(),
            "sqrt_guarded: floor {floor} for shape {}; the rule: positive and finite in the scalar type",
            self.shape()
        );
        unary::keep_input("sqrt_guarded", self, |x, y| forward(x, guard, y), move |x, g, out| backward(x, guard, g, out))
    }
}

#[derive(Clone, Copy, Debug)]
struct SqrtGuarded(f64);

impl Twin for SqrtGuarded {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].sqrt_guarded(self.0)
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        x[0].map(|x| x.max(N::constant(self.0)).sqrt())
    }
}

pub(crate) fn proof() -> Proof {
    Proof::unary("sqrt_guarded", SqrtGuarded(0.25), [-1.0, 2.0], &[0.25])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random_away, slopes, values};
    use crate::{Tape, Tensor};

    #[test]
    fn values_and_slopes_are_known_on_both_sides_of_the_floor_and_on_it() {
        let x = [-4.0, 0.0, 0.2, 0.25, 0.3, 9.0];
        close(&values(&x, |x| x.sqrt_guarded(0.25)), &[0.5, 0.5, 0.5, 0.5, 0.3_f64.sqrt(), 3.0]);
        close(&slopes(&x, |x| x.sqrt_guarded(0.25)), &[0.0, 0.0, 0.0, 1.0, 0.5 / 0.3_f64.sqrt(), 1.0 / 6.0]);
    }

    #[test]
    fn zero_with_a_zero_gradient_stays_finite() {
        close(&slopes(&[0.0], |x| x.sqrt_guarded(1e-12).scale(0.0)), &[0.0]);
    }

    #[test]
    fn nan_is_not_hidden() {
        assert!(values(&[f64::NAN], |x| x.sqrt_guarded(1.0))[0].is_nan());
        assert!(slopes(&[f64::NAN], |x| x.sqrt_guarded(1.0))[0].is_nan());
    }

    #[test]
    #[should_panic(expected = "sqrt_guarded: floor 0 for shape [1, 1, 1, 1]; the rule: positive and finite")]
    fn floor_zero_is_refused() {
        values(&[1.0], |x| x.sqrt_guarded(0.0));
    }

    #[test]
    #[should_panic(expected = "sqrt_guarded: floor 0.")]
    fn floor_that_vanishes_in_single_precision_is_refused() {
        Tape::<f32>::new().constant(Tensor::scalar(1.0)).sqrt_guarded(1e-60);
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), floor in 0.3..1.0, seed in any::<u64>()) {
            // One entry at least lies above the floor.
            let mut x = random_away(seed, shape, -1.0, 3.0, &[floor]).to_vec();
            x[0] = 2.0;
            testing::check(&[Tensor::from_vec(shape, x)], |v| v[0].sqrt_guarded(floor));
        }
    }
}
