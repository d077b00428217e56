//! `y = e^(x - m) / Σ e^(x - m)` along one axis, `m` the largest entry of the line.
//! Vector-Jacobian product: `y (g - Σ g y)`. No kinks. Keeps: the output.
//!
//! The largest exponent is 0, so nothing overflows and no sum is below 1. Sums are taken in `f64` in the order of the axis. A
//! line with NaN or plus infinity, or with nothing but minus infinity, is NaN throughout.

use super::axis::{Lines, rounded};
use super::blocks::assert_axis;
use super::unary;
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, shapes, total};
use crate::{Scalar, Var};

fn forward<T: Scalar>(x: &[T], y: &mut [T], lines: Lines) {
    let mut largest = vec![T::NEG_INFINITY; lines.count()];
    lines.fold(&mut largest, [x], |largest, _, [x]| if x > largest { x } else { largest });
    lines.update(y, [x], [&largest], |_, _, [x], [largest]| (x - largest).exp());
    let sums = rounded(&lines.sums([&*y], |[y]| y.to_f64()), |&sum| sum);
    lines.update(y, [], [&sums], |_, y, [], [sum]| y / sum);
}

fn backward<T: Scalar>(y: &[T], grad_y: &[T], grad_x: &mut [T], lines: Lines) {
    let means = rounded(&lines.sums([y, grad_y], |[y, g]| y.to_f64() * g.to_f64()), |&mean| mean);
    lines.update(grad_x, [y, grad_y], [&means], |_, _, [y, g], [mean]| y * (g - mean));
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Positive weights that add up to 1 along `axis` (0 to 3 for n, c, h, w).
    ///
    /// **Shapes**: any to the same.
    ///
    /// **Gradient**: `y (g - Σ g y)`, the sum along the axis.
    ///
    /// **Panics** for an axis above 3.
    #[track_caller]
    pub fn softmax(self, axis: usize) -> Var<'t, T> {
        assert_axis("softmax", axis, self.shape());
        let lines = Lines::along(self.shape(), axis);
        unary::keep_output("softmax", self, |x, y| forward(x, y, lines), move |y, g, out| backward(y, g, out, lines))
    }
}

#[derive(Debug)]
struct Softmax {
    axis: usize,
}

impl Twin for Softmax {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].softmax(self.axis)
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let x = &x[0];
        Plain::from_fn(x.shape, |i| x.at(i).exp() / total(x.line(i, self.axis).into_iter().map(N::exp)))
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("softmax");
    let shapes = shapes(&mut draw);
    let cases = shapes.iter().enumerate().flat_map(|(i, &shape)| {
        let axes = if shape.len() > 500 { i % 4..i % 4 + 1 } else { 0..4 };
        let x = draw.uniform(shape, -2.0, 2.0);
        axes.map(move |axis| Case::new(Softmax { axis }, [x.clone()]))
    });
    Proof::new("softmax", cases.collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random, row, slopes, values};
    use crate::{Shape, Tape, Tensor};

    #[test]
    fn values_and_gradient_are_known() {
        let tape = Tape::new();
        let x = tape.leaf(row(&[0.0, 2.0_f64.ln(), 5.0_f64.ln()]));
        let y = x.softmax(3);
        close(y.value().data(), &[0.125, 0.25, 0.625]);
        // With g = (8, 0, 0) the mean of g is 1.
        let loss = y.mul(tape.constant(row(&[8.0, 0.0, 0.0]))).sum();
        close(tape.backward(loss).wrt(x).data(), &[0.875, -0.25, -0.625]);
    }

    #[test]
    fn lines_run_along_the_chosen_axis() {
        let tape = Tape::<f64>::new();
        let x = Tensor::from_vec(Shape::new(1, 2, 1, 2), vec![0.0, 0.0, 3.0_f64.ln(), 0.0]);
        close(tape.constant(x.clone()).softmax(1).value().data(), &[0.25, 0.5, 0.75, 0.5]);
        close(tape.constant(x.clone()).softmax(3).value().data(), &[0.5, 0.5, 0.75, 0.25]);
        close(tape.constant(x).softmax(0).value().data(), &[1.0; 4]);
    }

    #[test]
    fn far_arguments_do_not_overflow() {
        close(&values(&[-1e4, 1e4, 1e4], |x| x.softmax(3)), &[0.0, 0.5, 0.5]);
        close(&slopes(&[-1e4, 1e4, 1e4], |x| x.softmax(3)), &[0.0; 3]);
        close(&values(&[f64::NEG_INFINITY, 7.0], |x| x.softmax(3)), &[0.0, 1.0]);
    }

    #[test]
    fn nan_spoils_its_line_and_no_other() {
        let tape = Tape::new();
        let x = tape.constant(Tensor::from_vec(Shape::new(1, 1, 2, 2), vec![f64::NAN, 1.0, 2.0, 2.0]));
        let y = x.softmax(3).value();
        assert!(y.data()[..2].iter().all(|y| y.is_nan()));
        close(&y.data()[2..], &[0.5, 0.5]);
        assert!(values(&[f64::NEG_INFINITY; 2], |x| x.softmax(3)).iter().all(|y| y.is_nan()));
    }

    #[test]
    #[should_panic(expected = "softmax: axis 4 of shape [1, 1, 1, 2]; the rule: 0 (n), 1 (c), 2 (h) or 3 (w)")]
    fn axis_four_is_refused() {
        values(&[1.0, 2.0], |x| x.softmax(4));
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(
            shape in testing::shapes(), axis in 0..4usize, len in 2..5usize, seed in any::<u64>()
        ) {
            testing::check(&[random(seed, shape.with_axis(axis, len), -2.0, 2.0)], |v| v[0].softmax(axis));
        }

        #[test]
        fn weights_add_up_to_one_and_a_common_term_changes_nothing(
            shape in testing::shapes(), axis in 0..4usize, term in -5.0..5.0, seed in any::<u64>()
        ) {
            let tape = Tape::<f64>::new();
            let x = tape.constant(random(seed, shape, -2.0, 2.0));
            let y = x.softmax(axis);
            let sums = y.sum_to(shape.with_axis(axis, 1)).value();
            close(sums.data(), &vec![1.0; sums.data().len()]);
            close(x.add_scalar(term).softmax(axis).value().data(), y.value().data());
        }
    }
}
