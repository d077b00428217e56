//! `y = x / max(r, eps)` along one axis, `r = √Σ x²` the length of the line.
//! Vector-Jacobian product: `(g - y Σ g y) / r` where `r > eps`, else `g / eps`; at the kink `r = eps` it is `g / eps`.
//! Keeps: the output and the lengths.
//!
//! Sums are taken in `f64` in the order of the axis. A line of zeros gives zeros. NaN spoils its whole line.

use super::axis::{Lines, rounded};
use super::blocks::assert_axis;
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, shapes};
use crate::{GradSink, Scalar, Shape, Tensor, Var};

/// Writes `y`, returns the lengths of the lines.
fn forward<T: Scalar>(x: &[T], y: &mut [T], lines: Lines, eps: T) -> Vec<T> {
    let lengths = rounded(&lines.sums([x], |[x]| x.to_f64() * x.to_f64()), |square| square.sqrt());
    lines.update(y, [x], [&lengths], |_, _, [x], [r]| if r <= eps { x / eps } else { x / r });
    lengths
}

fn backward<T: Scalar>(y: &[T], lengths: &[T], grad_y: &[T], grad_x: &mut [T], lines: Lines, eps: T) {
    let along = rounded(&lines.sums([y, grad_y], |[y, g]| y.to_f64() * g.to_f64()), |&along| along);
    lines.update(
        grad_x,
        [y, grad_y],
        [lengths, &along],
        |_, _, [y, g], [r, along]| {
            if r <= eps { g / eps } else { (g - y * along) / r }
        },
    );
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Lines of Euclidean length 1 along `axis` (0 to 3 for n, c, h, w); lines shorter than `eps` are divided by `eps`.
    ///
    /// **Shapes**: any to the same.
    ///
    /// **Gradient**: `(g - y Σ g y) / r` with the length `r`; `g / eps` where `r <= eps`. The usual `eps` is 1e-12.
    ///
    /// **Panics** for an axis above 3, or unless `eps` is positive and finite in `T`. Equals PyTorch's `normalize`.
    #[track_caller]
    pub fn l2_normalise(self, axis: usize, eps: f64) -> Var<'t, T> {
        let shape = self.shape();
        assert_axis("l2_normalise", axis, shape);
        let guard = T::from_f64(eps);
        assert!(
            guard > T::ZERO && guard.is_finite(),
            "l2_normalise: eps {eps} for shape {shape}; the rule: positive and finite in the scalar type"
        );
        let lines = Lines::along(shape, axis);
        let mut y = self.tape().scratch(shape.len());
        let lengths = forward(self.value().data(), &mut y, lines, guard);
        let y = self.tape().tensor(shape, y);
        let kept = y.clone();
        self.tape().push("l2_normalise", y, &[self], move |g: &Tensor<T>, grads: &mut GradSink<'_, T>| {
            if let Some(mut slot) = grads.slot(0) {
                slot.write(|out| backward(kept.data(), &lengths, g.data(), out, lines, guard));
            }
        })
    }
}

#[derive(Clone, Copy, Debug)]
struct L2Normalise {
    axis: usize,
    eps: f64,
}

impl Twin for L2Normalise {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].l2_normalise(self.axis, self.eps)
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let squares = x[0].map(|x| x * x).summed(x[0].shape.with_axis(self.axis, 1));
        Plain::from_fn(x[0].shape, |i| x[0].at(i) / squares.repeated(i).sqrt().max(N::constant(self.eps)))
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("l2_normalise");
    let mut cases = Vec::new();
    for (i, shape) in shapes(&mut draw).into_iter().enumerate() {
        for axis in if shape.len() > 500 { i % 4..i % 4 + 1 } else { 0..4 } {
            // A line of one entry has length 1 whatever the entry, so only the guard has a derivative there.
            let eps = if shape.0[axis] == 1 || i % 5 == 4 { 10.0 } else { 1e-12 };
            cases.push(Case::new(L2Normalise { axis, eps }, [draw.weights(shape)]));
        }
    }
    // Lines on both sides of the guard: lengths from 0.7 to 2.1, none within 0.05 of it.
    let lengths = Tensor::from_fn(Shape::new(2, 2, 3, 5), |n, _, h, w| [0.5, 0.9, 1.1, 1.5][(n + h + w) % 4]);
    cases.push(Case::new(L2Normalise { axis: 1, eps: 1.4 }, [lengths]));
    Proof::new("l2_normalise", cases)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random, row, slopes, values};
    use crate::{Shape, Tape, Tensor};

    #[test]
    fn values_and_gradient_are_known() {
        let tape = Tape::new();
        let x = tape.leaf(row(&[3.0, 4.0]));
        let y = x.l2_normalise(3, 1e-12);
        close(y.value().data(), &[0.6, 0.8]);
        // With g = (5, 0) the part along y is 3.
        let loss = y.mul(tape.constant(row(&[5.0, 0.0]))).sum();
        close(tape.backward(loss).wrt(x).data(), &[(5.0 - 0.6 * 3.0) / 5.0, -0.8 * 3.0 / 5.0]);
    }

    #[test]
    fn lines_run_along_the_chosen_axis() {
        let tape = Tape::new();
        let x = tape.constant(Tensor::from_vec(Shape::new(1, 2, 1, 2), vec![3.0, 0.0, 4.0, 2.0]));
        close(x.l2_normalise(1, 1e-12).value().data(), &[0.6, 0.0, 0.8, 1.0]);
        close(x.l2_normalise(0, 1e-12).value().data(), &[1.0, 0.0, 1.0, 1.0]);
    }

    #[test]
    fn slopes_are_known_below_at_and_above_the_guard() {
        // One entry of length |x|: above eps = 1/2 it has become the sign, at and below it is divided by eps.
        for (x, y, slope) in [(0.0, 0.0, 2.0), (-0.25, -0.5, 2.0), (0.5, 1.0, 2.0), (0.75, 1.0, 0.0)] {
            close(&values(&[x], |x| x.l2_normalise(3, 0.5)), &[y]);
            close(&slopes(&[x], |x| x.l2_normalise(3, 0.5)), &[slope]);
        }
    }

    #[test]
    fn nan_spoils_its_line_and_no_other() {
        let tape = Tape::new();
        let x = tape.constant(Tensor::from_vec(Shape::new(1, 1, 2, 2), vec![1.0, f64::NAN, 3.0, 4.0]));
        let y = x.l2_normalise(3, 1e-12).value();
        assert!(y.data()[..2].iter().all(|y| y.is_nan()));
        close(&y.data()[2..], &[0.6, 0.8]);
    }

    #[test]
    fn squares_do_not_overflow_in_single_precision() {
        let tape = Tape::new();
        let x = tape.constant(Tensor::from_vec(Shape::new(1, 1, 1, 2), vec![3e30_f32, 4e30]));
        let y = x.l2_normalise(3, 1e-12).value();
        assert!((y.data()[0] - 0.6).abs() < 1e-6 && (y.data()[1] - 0.8).abs() < 1e-6, "{y:?}");
    }

    #[test]
    #[should_panic(expected = "l2_normalise: eps 0 for shape [1, 1, 1, 2]; the rule: positive and finite")]
    fn eps_zero_is_refused() {
        values(&[1.0, 2.0], |x| x.l2_normalise(3, 0.0));
    }

    #[test]
    #[should_panic(expected = "l2_normalise: axis 7 of shape [1, 1, 1, 1]")]
    fn axis_seven_is_refused() {
        values(&[1.0], |x| x.l2_normalise(7, 1e-12));
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(
            shape in testing::shapes(), axis in 0..4usize, len in 2..5usize, short in any::<bool>(), seed in any::<u64>()
        ) {
            // All lines are either longer or shorter than the guard.
            let eps = if short { 10.0 } else { 1e-3 };
            let x = random(seed, shape.with_axis(axis, len), 0.2, 2.0);
            testing::check(&[x], |v| v[0].l2_normalise(axis, eps));
        }

        #[test]
        fn squares_add_up_to_one(shape in testing::shapes(), axis in 0..4usize, seed in any::<u64>()) {
            let tape = Tape::<f64>::new();
            let y = tape.constant(random(seed, shape, 0.1, 2.0)).l2_normalise(axis, 1e-12);
            let sums = y.square().sum_to(shape.with_axis(axis, 1)).value();
            close(sums.data(), &vec![1.0; sums.data().len()]);
        }
    }
}
