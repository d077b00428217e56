//! `y = min(a, b)`, entry by entry. Vector-Jacobian products: `g` to the smaller operand, 0 to the other; at the kink
//! `a = b` each gets `g / 2`. Keeps: both operands. NaN in either operand gives NaN.

use super::{binary, kernel};
use crate::proof::{Draw, Number, Plain, Proof, Twin};
use crate::{Scalar, Var};

fn forward<T: Scalar>(a: &[T], b: &[T], y: &mut [T]) {
    kernel::zip(y, a, b, |a, b| {
        if a < b {
            a
        } else if b < a {
            b
        } else if a == b {
            a
        } else {
            a + b // NaN
        }
    });
}

/// The share of the operand `own` against its `partner`.
fn backward<T: Scalar>(own: &[T], partner: &[T], grad_y: &[T], grad_own: &mut [T]) {
    let half = T::from_f64(0.5);
    kernel::zip3(grad_own, own, partner, grad_y, |own, partner, g| {
        if own > partner {
            T::ZERO
        } else if own == partner {
            half * g
        } else {
            g
        }
    });
}

impl<'t, T: Scalar> Var<'t, T> {
    /// The smaller of two entries, for tensors of one shape.
    ///
    /// **Gradient**: `g` to the smaller entry, 0 to the other, `g / 2` to each where they are equal.
    ///
    /// **Panics** when the shapes differ.
    #[track_caller]
    pub fn minimum(self, other: Var<'t, T>) -> Var<'t, T> {
        binary::keep_both("minimum", self, other, forward, backward, |a, b, g, out| backward(b, a, g, out))
    }
}

#[derive(Clone, Copy, Debug)]
struct Minimum;

impl Twin for Minimum {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].minimum(v[1])
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        x[0].zip(&x[1], |a, b| if a.value() < b.value() { a } else { b })
    }
}

pub(crate) fn proof() -> Proof {
    Proof::binary("minimum", Minimum, |draw: &mut Draw, shape| draw.apart(shape))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random, row, slopes2, values2};
    use crate::{Shape, Tape, Tensor};

    #[test]
    fn values_and_slopes_are_known_also_at_a_tie() {
        let (a, b) = ([1.0, 5.0, -2.0], [3.0, 4.0, -2.0]);
        close(&values2(&a, &b, |a, b| a.minimum(b)), &[1.0, 4.0, -2.0]);
        let (to_a, to_b) = slopes2(&a, &b, |a, b| a.minimum(b));
        close(&to_a, &[1.0, 0.0, 0.5]);
        close(&to_b, &[0.0, 1.0, 0.5]);
    }

    #[test]
    fn nan_in_either_operand_is_not_hidden() {
        let y = values2(&[f64::NAN, 1.0], &[1.0, f64::NAN], |a, b| a.minimum(b));
        assert!(y.iter().all(|y| y.is_nan()), "{y:?}");
    }

    #[test]
    #[should_panic(expected = "minimum: operands must have equal shapes, got [1, 1, 1, 2] and [1, 1, 2, 1]")]
    fn different_shapes_are_refused() {
        let tape = Tape::new();
        tape.leaf(row(&[1.0, 2.0])).minimum(tape.leaf(Tensor::zeros(Shape::new(1, 1, 2, 1))));
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), seed in any::<u64>()) {
            let a: Tensor<f64> = random(seed, shape, -2.0, 2.0);
            let apart = random::<f64>(seed ^ 1, shape, -1.0, 1.0);
            let b = a.data().iter().zip(apart.data()).map(|(a, d)| a + d + 0.05_f64.copysign(*d)).collect();
            testing::check(&[a, Tensor::from_vec(shape, b)], |v| v[0].minimum(v[1]));
        }
    }
}
