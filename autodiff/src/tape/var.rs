//! A handle to a value of the tape.

use std::fmt;

use super::Tape;
use crate::{Scalar, Shape, Tensor};

/// A handle to a value on a tape; cheap to copy.
pub struct Var<'t, T: Scalar> {
    pub(super) tape: &'t Tape<T>,
    pub(crate) id: usize,
}

impl<T: Scalar> Clone for Var<'_, T> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<T: Scalar> Copy for Var<'_, T> {}

impl<T: Scalar> fmt::Debug for Var<'_, T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let nodes = self.tape.nodes();
        write!(f, "Var #{} {} {}", self.id, nodes[self.id].op, nodes[self.id].shape)
    }
}

impl<'t, T: Scalar> Var<'t, T> {
    /// The tape that holds this variable.
    pub fn tape(self) -> &'t Tape<T> {
        self.tape
    }

    /// The value.
    ///
    /// # Panics
    /// When the value was freed by [`Tape::backward_and_free`] or [`Var::release`].
    #[track_caller]
    pub fn value(self) -> Tensor<T> {
        let nodes = self.tape.nodes();
        let node = &nodes[self.id];
        let freed = || panic!("value of {} {} was freed by backward_and_free or release", node.op, node.shape);
        node.value.clone().unwrap_or_else(freed)
    }

    /// Whether both are the same node of the same tape.
    pub(crate) fn is(self, other: Self) -> bool {
        std::ptr::eq(self.tape, other.tape) && self.id == other.id
    }

    /// The shape of the value.
    pub fn shape(self) -> Shape {
        self.tape.nodes()[self.id].shape
    }

    /// Whether a leaf is among this variable's ancestors (or it is one).
    pub fn requires_grad(self) -> bool {
        self.tape.nodes()[self.id].requires_grad
    }

    /// The same value cut off from its history: no gradient passes.
    pub fn detach(self) -> Var<'t, T> {
        self.tape.constant(self.value())
    }

    /// Gives up the value, which nothing will ask for again: only what backward rules keep of it stays in memory.
    ///
    /// The variable still passes its gradient. To be called by whoever made the variable.
    pub fn release(self) {
        self.tape.nodes()[self.id].value = None;
    }

    /// `last(self)`, after which the value is [released](Var::release).
    ///
    /// ```
    /// use dimode_autodiff::{Tape, Tensor};
    ///
    /// let tape = Tape::<f64>::new();
    /// let x = tape.leaf(Tensor::scalar(3.0));
    /// // The sum is gone as soon as the rectifier has read it.
    /// let y = x.add(x).last_use(|sum| sum.relu());
    /// assert_eq!(tape.backward(y).wrt(x).item(), 2.0);
    /// ```
    #[must_use]
    pub fn last_use(self, last: impl FnOnce(Self) -> Self) -> Self {
        let result = last(self);
        self.release();
        result
    }

    /// Asks the backward pass to keep the gradient of this intermediate variable.
    pub fn retain_grad(self) -> Var<'t, T> {
        let mut nodes = self.tape.nodes();
        let node = &mut nodes[self.id];
        node.keeps_grad = node.requires_grad;
        drop(nodes);
        self
    }
}
