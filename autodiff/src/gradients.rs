//! What a backward pass gives back.

use crate::{Scalar, Shape, Tensor, Var};

/// Gradients of one scalar.
pub struct Gradients<T: Scalar> {
    pub(crate) grads: Vec<Option<Tensor<T>>>,
    pub(crate) shapes: Vec<Shape>,
    /// The nodes whose gradient served and was dropped.
    pub(crate) dropped: Vec<bool>,
}

impl<T: Scalar> Gradients<T> {
    /// The gradient with respect to a leaf or retained variable; `None` when no path leads to it.
    pub fn get(&self, var: Var<'_, T>) -> Option<&Tensor<T>> {
        self.grads.get(var.id).and_then(Option::as_ref)
    }

    /// The same, taken out.
    pub(crate) fn take(&mut self, var: Var<'_, T>) -> Option<Tensor<T>> {
        self.grads.get_mut(var.id).and_then(Option::take)
    }

    /// The gradient with respect to a leaf or retained variable; zeros when no path leads to it.
    ///
    /// # Panics
    /// When the variable is an operation's output without [`Var::retain_grad`], or was recorded after the backward pass.
    #[track_caller]
    pub fn wrt(&self, var: Var<'_, T>) -> Tensor<T> {
        assert!(var.id < self.shapes.len(), "wrt: the variable was recorded after this backward pass");
        let shape = self.shapes[var.id];
        assert!(!self.dropped[var.id], "wrt: the gradient of {shape} was not kept; the rule: leaves, and what retain_grad marks");
        self.get(var).cloned().unwrap_or_else(|| Tensor::zeros(shape))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Tape;

    #[test]
    #[should_panic(expected = "wrt: the gradient of [1, 1, 1, 1] was not kept")]
    fn a_gradient_that_was_not_kept_is_refused() {
        let tape = Tape::<f64>::new();
        let middle = tape.leaf(Tensor::scalar(1.0)).square();
        tape.backward(middle.square()).wrt(middle);
    }

    #[test]
    #[should_panic(expected = "wrt: the variable was recorded after this backward pass")]
    fn a_later_variable_has_no_gradient() {
        let tape = Tape::<f64>::new();
        let x = tape.leaf(Tensor::scalar(1.0));
        let grads = tape.backward(x.square());
        grads.wrt(x.square());
    }
}
