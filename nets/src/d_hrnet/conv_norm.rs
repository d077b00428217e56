//! A convolution and its batch normalisation.

use dimode_autodiff::{Activation, Scalar, Var};

use crate::layers::{BatchNorm, ConvLayer};
use crate::{Binder, Blueprint};

/// Convolution without bias, batch normalisation, perhaps a sum and an activation.
///
/// Weights start Kaiming normal, as those of the ResNets here do; the reference starts from trained ones.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ConvNorm {
    conv: ConvLayer,
    norm: BatchNorm,
}

impl ConvNorm {
    /// The pair whose tensors are stored at `conv` and `norm`.
    pub(super) fn new(conv: String, norm: String, [inputs, outputs]: [usize; 2], kernel: usize, stride: usize) -> Self {
        Self {
            conv: ConvLayer::new(conv, inputs, outputs, kernel).stride(stride).without_bias().kaiming(),
            norm: BatchNorm::new(norm, outputs),
        }
    }

    /// The pair stored at `path.0` and `path.1`.
    pub(super) fn pair(path: &str, channels: [usize; 2], kernel: usize, stride: usize) -> Self {
        Self::new(format!("{path}.0"), format!("{path}.1"), channels, kernel, stride)
    }

    pub(super) fn declare(&self, blueprint: &mut Blueprint) {
        self.conv.declare(blueprint);
        self.norm.declare(blueprint);
    }

    /// (N, in, H, W) -> (N, out, H / stride, W / stride).
    pub(super) fn forward<'t, T: Scalar>(&self, binder: &mut Binder<'t, T>, x: Var<'t, T>, activation: Activation) -> Var<'t, T> {
        self.joined(binder, x, None, activation)
    }

    /// The same with `skip` added before the activation.
    pub(super) fn joined<'t, T: Scalar>(
        &self,
        binder: &mut Binder<'t, T>,
        x: Var<'t, T>,
        skip: Option<Var<'t, T>>,
        activation: Activation,
    ) -> Var<'t, T> {
        self.conv.forward(binder, x).last_use(|y| self.norm.activated(binder, y, skip, activation))
    }
}
