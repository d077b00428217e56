//! The shared frame of operations with one operand and an output of the same shape.
//!
//! An operation brings two plain slice kernels, `forward(x, y)` and a backward kernel that writes its
//! contribution to the gradient of `x`; the three functions here differ in what they keep alive for the backward pass.

use crate::{GradSink, Scalar, Tensor, Var};

/// Records an operation whose backward kernel `(x, grad_y, grad_x)` reads the input.
pub(crate) fn keep_input<'t, T: Scalar>(
    op: &'static str,
    x: Var<'t, T>,
    forward: impl FnOnce(&[T], &mut [T]),
    backward: impl Fn(&[T], &[T], &mut [T]) + Send + 'static,
) -> Var<'t, T> {
    let input = x.value();
    let y = output(x, forward);
    let record = move |g: &Tensor<T>, grads: &mut GradSink<'_, T>| {
        if let Some(mut slot) = grads.slot(0) {
            slot.write(|out| backward(input.data(), g.data(), out));
        }
    };
    x.tape().push(op, y, &[x], record)
}

/// Records an operation whose backward kernel `(y, grad_y, grad_x)` reads the output.
pub(crate) fn keep_output<'t, T: Scalar>(
    op: &'static str,
    x: Var<'t, T>,
    forward: impl FnOnce(&[T], &mut [T]),
    backward: impl Fn(&[T], &[T], &mut [T]) + Send + 'static,
) -> Var<'t, T> {
    let y = output(x, forward);
    let kept = y.clone();
    let record = move |g: &Tensor<T>, grads: &mut GradSink<'_, T>| {
        if let Some(mut slot) = grads.slot(0) {
            slot.write(|out| backward(kept.data(), g.data(), out));
        }
    };
    x.tape().push(op, y, &[x], record)
}

/// Records an operation whose backward kernel `(grad_y, grad_x)` reads neither input nor output.
pub(crate) fn keep_nothing<'t, T: Scalar>(
    op: &'static str,
    x: Var<'t, T>,
    forward: impl FnOnce(&[T], &mut [T]),
    backward: impl Fn(&[T], &mut [T]) + Send + 'static,
) -> Var<'t, T> {
    let y = output(x, forward);
    let record = move |g: &Tensor<T>, grads: &mut GradSink<'_, T>| {
        if let Some(mut slot) = grads.slot(0) {
            slot.write(|out| backward(g.data(), out));
        }
    };
    x.tape().push(op, y, &[x], record)
}

/// Writes `forward(x, y)` into a fresh tensor of the operand's shape.
pub(crate) fn output<T: Scalar>(x: Var<'_, T>, forward: impl FnOnce(&[T], &mut [T])) -> Tensor<T> {
    let mut y = x.tape().scratch(x.shape().len());
    forward(x.value().data(), &mut y);
    x.tape().tensor(x.shape(), y)
}
