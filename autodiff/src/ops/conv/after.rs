//! What is done to an output behind its products: bias and activation.

use crate::activation::{Activate, with_activation};
use crate::ops::kernel;
use crate::{Activation, Scalar};

/// Bias and activation of a convolution.
#[derive(Clone, Copy)]
pub struct After<'a, T> {
    /// One number for each output channel.
    pub bias: Option<&'a [T]>,
    pub activation: Activation,
}

impl<T: Scalar> After<'_, T> {
    /// Nothing at all.
    pub const NOTHING: After<'static, T> = After { bias: None, activation: Activation::Identity };

    /// What is added to an output channel.
    pub fn bias(&self, output: usize) -> T {
        self.bias.map_or(T::ZERO, |bias| bias[output])
    }

    /// The activation of finished outputs: to be called while they are in a near cache.
    pub fn activate(&self, y: &mut [T]) {
        if self.activation != Activation::Identity {
            with_activation!(self.activation, |a| kernel::update(y, |y| a.of(y)));
        }
    }
}
