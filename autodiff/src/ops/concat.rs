//! `y` = the operands one after the other along one axis. Vector-Jacobian product: each operand gets its part of `g`.
//! Linear. Keeps: nothing but sizes.

use super::blocks::{assert_axis, band};
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, shapes, with};
use crate::{GradSink, Scalar, Shape, Tensor, Var};

/// Writes `x` into the band of `y` that begins at index `start` of `axis`.
fn forward<T: Scalar>(x: &[T], size: usize, y: &mut [T], shape: Shape, axis: usize, start: usize) {
    let mut at = 0;
    for range in band(shape, axis, start, size) {
        let len = range.len();
        y[range].copy_from_slice(&x[at..at + len]);
        at += len;
    }
}

/// Writes the band of `grad_y` that begins at index `start` of `axis` into `grad_x`.
fn backward<T: Scalar>(grad_y: &[T], shape: Shape, axis: usize, start: usize, size: usize, grad_x: &mut [T]) {
    let mut at = 0;
    for range in band(shape, axis, start, size) {
        let len = range.len();
        grad_x[at..at + len].copy_from_slice(&grad_y[range]);
        at += len;
    }
}

/// The shape of the result; all operands agree in every axis but `axis`.
#[track_caller]
fn joined(parts: &[Shape], axis: usize) -> Shape {
    assert!(!parts.is_empty(), "concat: no operands; the rule: at least one");
    let mut shape = parts[0];
    assert_axis("concat", axis, shape);
    for part in &parts[1..] {
        let agree = (0..4).all(|i| i == axis || part.0[i] == shape.0[i]);
        assert!(agree, "concat along axis {axis}: {} and {part} differ elsewhere; the rule: equal in every other axis", parts[0]);
        shape.0[axis] += part.0[axis];
    }
    shape
}

impl<'t, T: Scalar> Var<'t, T> {
    /// The operands joined along `axis` (0 to 3 for n, c, h, w).
    ///
    /// **Gradient**: to each operand its part of `g`.
    ///
    /// **Panics** without operands, for an axis above 3, or when the shapes differ in another axis.
    #[track_caller]
    pub fn concat(parts: &[Var<'t, T>], axis: usize) -> Var<'t, T> {
        let shapes: Vec<Shape> = parts.iter().map(|x| x.shape()).collect();
        let shape = joined(&shapes, axis);
        let tape = parts[0].tape();
        let sizes: Vec<usize> = shapes.iter().map(|s| s.0[axis]).collect();
        let mut y = tape.scratch(shape.len());
        let mut start = 0;
        for (x, &size) in parts.iter().zip(&sizes) {
            forward(x.value().data(), size, &mut y, shape, axis, start);
            start += size;
        }
        tape.push("concat", tape.tensor(shape, y), parts, move |g: &Tensor<T>, grads: &mut GradSink<'_, T>| {
            let mut start = 0;
            for (parent, &size) in sizes.iter().enumerate() {
                if let Some(mut slot) = grads.slot(parent) {
                    slot.write(|out| backward(g.data(), shape, axis, start, size, out));
                }
                start += size;
            }
        })
    }
}

#[derive(Clone, Copy, Debug)]
struct Concat(usize);

impl Twin for Concat {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        Var::concat(v, self.0)
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let sizes = x.iter().map(|part| part.shape.0[self.0]);
        Plain::from_fn(x[0].shape.with_axis(self.0, sizes.sum()), |i| {
            let (mut part, mut k) = (0, i[self.0]);
            while k >= x[part].shape.0[self.0] {
                k -= x[part].shape.0[self.0];
                part += 1;
            }
            x[part].at(with(i, self.0, k))
        })
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("concat");
    let mut cases = Vec::new();
    for (i, shape) in shapes(&mut draw).into_iter().enumerate() {
        let axis = i % 4;
        let parts: Vec<_> = (0..1 + i % 3)
            .map(|part| {
                let size = if part == 0 { shape.0[axis] } else { draw.size(1, 4) };
                draw.uniform(shape.with_axis(axis, size), -2.0, 2.0)
            })
            .collect();
        let case = Case::new(Concat(axis), parts);
        cases.push(if i == 7 { case.constant(0) } else { case });
    }
    Proof::new("concat", cases)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random};
    use crate::{Shape, Tape, Tensor, Var};

    #[test]
    fn values_and_gradient_are_known() {
        let tape = Tape::new();
        let a = tape.leaf(Tensor::from_vec(Shape::new(2, 1, 1, 2), vec![1.0, 2.0, 3.0, 4.0]));
        let b = tape.leaf(Tensor::from_vec(Shape::new(2, 1, 1, 1), vec![5.0, 6.0]));
        let y = Var::concat(&[a, b], 3);
        assert_eq!(y.shape(), Shape::new(2, 1, 1, 3));
        close(y.value().data(), &[1.0, 2.0, 5.0, 3.0, 4.0, 6.0]);
        let weights = tape.constant(Tensor::from_fn(y.shape(), |n, _, _, w| (10 * n + w) as f64));
        let grads = tape.backward(y.mul(weights).sum());
        close(grads.wrt(a).data(), &[0.0, 1.0, 10.0, 11.0]);
        close(grads.wrt(b).data(), &[2.0, 12.0]);
    }

    #[test]
    fn same_variable_twice_collects_both_parts() {
        let tape = Tape::new();
        let x = tape.leaf(Tensor::scalar(4.0));
        let weights = tape.constant(Tensor::from_vec(Shape::new(1, 2, 1, 1), vec![3.0, 5.0]));
        close(tape.backward(Var::concat(&[x, x], 1).mul(weights).sum()).wrt(x).data(), &[8.0]);
    }

    #[test]
    #[should_panic(expected = "concat along axis 1: [1, 2, 3, 4] and [1, 2, 4, 3] differ elsewhere")]
    fn different_planes_are_refused() {
        let tape = Tape::<f64>::new();
        let a = tape.leaf(Tensor::zeros(Shape::new(1, 2, 3, 4)));
        Var::concat(&[a, tape.leaf(Tensor::zeros(Shape::new(1, 2, 4, 3)))], 1);
    }

    #[test]
    #[should_panic(expected = "concat: no operands")]
    fn no_operands_are_refused() {
        Var::<f64>::concat(&[], 1);
    }

    fn resized(shape: Shape, axis: usize, size: usize) -> Shape {
        let mut shape = shape;
        shape.0[axis] = size;
        shape
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(
            shape in testing::shapes(), axis in 0..4usize, size in 1..3usize, seed in any::<u64>()
        ) {
            let (a, b) = (random(seed, shape, -2.0, 2.0), random(seed ^ 1, resized(shape, axis, size), -2.0, 2.0));
            testing::check(&[a, b], |v| Var::concat(&[v[0], v[1], v[0]], axis));
        }

        #[test]
        fn adjoint_law_holds(shape in testing::shapes(), axis in 0..4usize, seed in any::<u64>()) {
            testing::check_adjoint(shape, seed, |x| Var::concat(&[x.scale(2.0), x], axis));
        }

        #[test]
        fn slices_of_the_result_are_the_operands(
            shape in testing::shapes(), axis in 0..4usize, size in 1..3usize, seed in any::<u64>()
        ) {
            let tape = Tape::<f64>::new();
            let a = tape.leaf(random(seed, shape, -2.0, 2.0));
            let b = tape.leaf(random(seed ^ 1, resized(shape, axis, size), -2.0, 2.0));
            let y = Var::concat(&[a, b], axis);
            prop_assert_eq!(y.slice(axis, 0, shape.0[axis]).value(), a.value());
            prop_assert_eq!(y.slice(axis, shape.0[axis], size).value(), b.value());
        }
    }
}
