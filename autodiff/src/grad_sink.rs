//! What a backward rule adds to: the gradients of an operation's parents.

use std::sync::Arc;

use crate::gradients::Place;
use crate::segments::Segments;
use crate::{Pool, Scalar, Shape, Tensor};

/// Where an operation's backward pass puts its results: one slot for each parent.
pub struct GradSink<'a, T: Scalar> {
    pub(crate) parents: &'a [usize],
    pub(crate) places: &'a mut Segments<Place<T>>,
    pub(crate) pool: &'a Arc<Pool<T>>,
}

impl<T: Scalar> GradSink<'_, T> {
    /// Number of parents.
    #[allow(clippy::len_without_is_empty, reason = "an operation without parents has no backward pass")]
    pub fn len(&self) -> usize {
        self.parents.len()
    }

    /// Whether the gradient of parent `k` is wanted.
    pub fn needs(&self, k: usize) -> bool {
        self.places[self.parents[k]].needed
    }

    /// The slot of parent `k`, or `None` when its gradient is not wanted.
    pub fn slot(&mut self, k: usize) -> Option<GradSlot<'_, T>> {
        let place = &mut self.places[self.parents[k]];
        place.needed.then_some(GradSlot { shape: place.shape, grad: &mut place.grad, pool: self.pool })
    }

    /// Takes the gradient so far of parent `k` out of its slot.
    pub(crate) fn take(&mut self, k: usize) -> Option<Tensor<T>> {
        self.places[self.parents[k]].grad.take()
    }

    /// Puts the gradient so far of parent `k` into its slot.
    pub(crate) fn put(&mut self, k: usize, gradient: Option<Tensor<T>>) {
        self.places[self.parents[k]].grad = gradient;
    }

    /// The pool of the tape's buffers.
    pub(crate) fn pool(&self) -> &Arc<Pool<T>> {
        self.pool
    }

    /// A pooled scratch buffer with arbitrary contents; give it back by [`GradSink::give_back`].
    pub fn scratch(&self, len: usize) -> Vec<T> {
        self.pool.take(len)
    }

    /// Returns a scratch buffer to the pool.
    pub fn give_back(&self, buffer: Vec<T>) {
        self.pool.give(buffer);
    }
}

/// The gradient of one parent, under accumulation.
pub struct GradSlot<'a, T: Scalar> {
    pub(crate) shape: Shape,
    pub(crate) grad: &'a mut Option<Tensor<T>>,
    pub(crate) pool: &'a Arc<Pool<T>>,
}

impl<T: Scalar> GradSlot<'_, T> {
    /// The gradient so far, zeros at first; add to it.
    pub fn as_mut_slice(&mut self) -> &mut [T] {
        let (shape, pool) = (self.shape, self.pool);
        self.grad.get_or_insert_with(|| Tensor::pooled(shape, pool.take_zeroed(shape.len()), pool)).make_mut()
    }

    /// Adds `f(i)` to element `i`, in order.
    pub fn accumulate(&mut self, f: impl Fn(usize) -> T) {
        for (i, g) in self.as_mut_slice().iter_mut().enumerate() {
            *g += f(i);
        }
    }

    /// Lets `write` fill a fresh buffer (arbitrary contents) that becomes the contribution.
    ///
    /// Cheaper than [`GradSlot::as_mut_slice`] for operations that compute every element: nothing is zeroed first.
    pub fn write(&mut self, write: impl FnOnce(&mut [T])) {
        let mut fresh = self.pool.take(self.shape.len());
        write(&mut fresh);
        self.add_fresh(fresh);
    }

    /// Adds a buffer from [`GradSink::scratch`]; the first contribution becomes the gradient without a copy.
    ///
    /// # Panics
    /// When the number of elements differs from the parent's.
    #[track_caller]
    pub fn add_fresh(&mut self, fresh: Vec<T>) {
        let fresh = Tensor::pooled(self.shape, fresh, self.pool);
        self.add_tensor(&fresh);
    }

    /// Adds a whole tensor; the first contribution is shared, not copied.
    ///
    /// # Panics
    /// When the number of elements differs from the parent's.
    #[track_caller]
    pub fn add_tensor(&mut self, contribution: &Tensor<T>) {
        if self.grad.is_none() {
            *self.grad = Some(contribution.reshaped(self.shape));
        } else {
            crate::ops::kernel::map_add(self.as_mut_slice(), contribution.data(), |x| x);
        }
    }
}
