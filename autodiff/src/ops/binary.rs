//! The shared frame of operations with two operands of one shape: the shape check and the recording.

use crate::shape::assert_same;
use crate::{GradSink, Scalar, Tensor, Var};

/// Writes `forward(a, b, y)` into a fresh tensor of the operands' shape.
pub(crate) fn output<T: Scalar>(a: Var<'_, T>, b: Var<'_, T>, forward: impl FnOnce(&[T], &[T], &mut [T])) -> Tensor<T> {
    let mut y = a.tape().scratch(a.shape().len());
    forward(a.value().data(), b.value().data(), &mut y);
    a.tape().tensor(a.shape(), y)
}

/// Records an operation whose backward kernels `(a, b, grad_y, grad_operand)` read both operands and write one contribution.
#[track_caller]
pub(crate) fn keep_both<'t, T: Scalar>(
    op: &'static str,
    a: Var<'t, T>,
    b: Var<'t, T>,
    forward: impl FnOnce(&[T], &[T], &mut [T]),
    backward_a: impl Fn(&[T], &[T], &[T], &mut [T]) + Send + 'static,
    backward_b: impl Fn(&[T], &[T], &[T], &mut [T]) + Send + 'static,
) -> Var<'t, T> {
    assert_same(op, a.shape(), b.shape());
    let y = output(a, b, forward);
    let (left, right) = (a.value(), b.value());
    let record = move |g: &Tensor<T>, grads: &mut GradSink<'_, T>| {
        if let Some(mut slot) = grads.slot(0) {
            slot.write(|out| backward_a(left.data(), right.data(), g.data(), out));
        }
        if let Some(mut slot) = grads.slot(1) {
            slot.write(|out| backward_b(left.data(), right.data(), g.data(), out));
        }
    };
    a.tape().push(op, y, &[a, b], record)
}
