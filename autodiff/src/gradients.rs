//! What a backward pass gives back.

use crate::segments::Segments;
use crate::{Scalar, Shape, Tensor, Var};

/// The gradient of one node, and what becomes of it.
pub(crate) struct Place<T: Scalar> {
    pub(crate) shape: Shape,
    /// Whether it is wanted at all.
    pub(crate) needed: bool,
    /// Whether it stays when it has served.
    pub(crate) kept: bool,
    pub(crate) grad: Option<Tensor<T>>,
}

/// Gradients of one scalar.
pub struct Gradients<T: Scalar> {
    pub(crate) places: Segments<Place<T>>,
}

impl<T: Scalar> Gradients<T> {
    /// The gradient with respect to a leaf or retained variable; `None` when no path leads to it.
    pub fn get(&self, var: Var<'_, T>) -> Option<&Tensor<T>> {
        self.places.get(var.id)?.grad.as_ref()
    }

    /// The same, taken out.
    pub(crate) fn take(&mut self, var: Var<'_, T>) -> Option<Tensor<T>> {
        self.places.get_mut(var.id)?.grad.take()
    }

    /// The gradient with respect to a leaf or retained variable; zeros when no path leads to it.
    ///
    /// # Panics
    /// When the variable is an operation's output without [`Var::retain_grad`], or was recorded after the backward pass.
    #[track_caller]
    pub fn wrt(&self, var: Var<'_, T>) -> Tensor<T> {
        let place = self.places.get(var.id);
        let Place { shape, needed, kept, grad } = place.expect("wrt: the variable was recorded after this backward pass");
        assert!(*kept || !needed, "wrt: the gradient of {shape} was not kept; the rule: leaves, and what retain_grad marks");
        grad.clone().unwrap_or_else(|| var.tape().tensor(*shape, var.tape().buffer(shape.len())))
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
