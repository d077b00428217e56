//! `y` = the indices `start .. start + len` of one axis. Vector-Jacobian product: `g` at these indices, 0 elsewhere.
//! Linear. Keeps: nothing but sizes.

use super::blocks::{assert_axis, band};
use super::kernel;
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, shapes, with};
use crate::{GradSink, Scalar, Shape, Tensor, Var};

fn forward<T: Scalar>(x: &[T], shape: Shape, axis: usize, start: usize, len: usize, y: &mut [T]) {
    let mut at = 0;
    for range in band(shape, axis, start, len) {
        let len = range.len();
        y[at..at + len].copy_from_slice(&x[range]);
        at += len;
    }
}

/// Adds, as the rest of `grad_x` stays what it is.
fn backward<T: Scalar>(grad_y: &[T], shape: Shape, axis: usize, start: usize, len: usize, grad_x: &mut [T]) {
    let mut at = 0;
    for range in band(shape, axis, start, len) {
        let len = range.len();
        kernel::map_add(&mut grad_x[range], &grad_y[at..at + len], |g| g);
        at += len;
    }
}

impl<'t, T: Scalar> Var<'t, T> {
    /// The indices `start .. start + len` of `axis` (0 to 3 for n, c, h, w).
    ///
    /// **Gradient**: `g` at these indices, 0 elsewhere.
    ///
    /// **Panics** for an axis above 3, or when the indices leave the axis, or there is none.
    #[track_caller]
    pub fn slice(self, axis: usize, start: usize, len: usize) -> Var<'t, T> {
        let shape = self.shape();
        assert_axis("slice", axis, shape);
        let size = shape.0[axis];
        assert!(
            len > 0 && start.checked_add(len).is_some_and(|end| end <= size),
            "slice: start {start}, length {len} on axis {axis} of {shape}; the rule: start + length <= {size}, length > 0"
        );
        let mut part = shape;
        part.0[axis] = len;
        let mut y = self.tape().scratch(part.len());
        forward(self.value().data(), shape, axis, start, len, &mut y);
        let y = self.tape().tensor(part, y);
        self.tape().push("slice", y, &[self], move |g: &Tensor<T>, grads: &mut GradSink<'_, T>| {
            if let Some(mut slot) = grads.slot(0) {
                backward(g.data(), shape, axis, start, len, slot.as_mut_slice());
            }
        })
    }
}

#[derive(Clone, Copy, Debug)]
struct Slice {
    axis: usize,
    start: usize,
    len: usize,
}

impl Twin for Slice {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].slice(self.axis, self.start, self.len)
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let shape = x[0].shape.with_axis(self.axis, self.len);
        Plain::from_fn(shape, |i| x[0].at(with(i, self.axis, i[self.axis] + self.start)))
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("slice");
    let mut cases = Vec::new();
    for shape in shapes(&mut draw) {
        for axis in 0..4 {
            let start = draw.size(0, shape.0[axis] - 1);
            let len = draw.size(1, shape.0[axis] - start);
            cases.push(Case::new(Slice { axis, start, len }, [draw.uniform(shape, -2.0, 2.0)]));
        }
    }
    Proof::new("slice", cases)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random};
    use crate::{Shape, Tape, Tensor};

    #[test]
    fn values_and_gradient_are_known() {
        let tape = Tape::new();
        let x = tape.leaf(Tensor::from_fn(Shape::new(2, 3, 1, 2), |n, c, _, w| (100 * n + 10 * c + w) as f64));
        let y = x.slice(1, 1, 1);
        assert_eq!(y.shape(), Shape::new(2, 1, 1, 2));
        close(y.value().data(), &[10.0, 11.0, 110.0, 111.0]);
        let grads = tape.backward(y.sum());
        close(grads.wrt(x).data(), &[0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0]);
    }

    #[test]
    fn overlapping_slices_sum_their_gradients() {
        let tape = Tape::new();
        let x = tape.leaf(Tensor::from_vec(Shape::new(1, 1, 1, 3), vec![1.0, 2.0, 4.0]));
        let steps = x.slice(3, 1, 2).sub(x.slice(3, 0, 2));
        close(steps.value().data(), &[1.0, 2.0]);
        close(tape.backward(steps.square().sum()).wrt(x).data(), &[-2.0, -2.0, 4.0]);
    }

    #[test]
    #[should_panic(expected = "slice: start 2, length 2 on axis 1 of [1, 3, 1, 1]; the rule: start + length <= 3")]
    fn indices_beyond_the_axis_are_refused() {
        Tape::<f64>::new().leaf(Tensor::zeros(Shape::new(1, 3, 1, 1))).slice(1, 2, 2);
    }

    #[test]
    #[should_panic(expected = "slice: axis 4 of shape [1, 3, 1, 1]")]
    fn fifth_axis_is_refused() {
        Tape::<f64>::new().leaf(Tensor::zeros(Shape::new(1, 3, 1, 1))).slice(4, 0, 1);
    }

    /// A band inside an axis, from two numbers.
    fn inside(size: usize, a: usize, b: usize) -> (usize, usize) {
        let start = a % size;
        (start, 1 + b % (size - start))
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(
            shape in testing::shapes(), axis in 0..4usize, a in 0..9usize, b in 0..9usize, seed in any::<u64>()
        ) {
            let (start, len) = inside(shape.0[axis], a, b);
            testing::check(&[random(seed, shape, -2.0, 2.0)], |v| v[0].slice(axis, start, len));
        }

        #[test]
        fn adjoint_law_holds(
            shape in testing::shapes(), axis in 0..4usize, a in 0..9usize, b in 0..9usize, seed in any::<u64>()
        ) {
            let (start, len) = inside(shape.0[axis], a, b);
            testing::check_adjoint(shape, seed, |x| x.slice(axis, start, len));
        }
    }
}
