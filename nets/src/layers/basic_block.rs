//! The two-convolution residual block of ResNet-18.

use dimode_autodiff::{Activation, Scalar, Var};

use super::{BatchNorm, ConvLayer};
use crate::{Binder, Blueprint};

/// `ReLU(BN2(conv3x3(ReLU(BN1(conv3x3_s(x))))) + skip)`, where the skip is `x`, or
/// `BN(conv1x1_s(x))` when stride or width change.
#[derive(Clone, Debug, PartialEq)]
pub struct BasicBlock {
    conv1: ConvLayer,
    norm1: BatchNorm,
    conv2: ConvLayer,
    norm2: BatchNorm,
    skip: Option<(ConvLayer, BatchNorm)>,
}

impl BasicBlock {
    /// The block stored under `path`.
    pub fn new(path: &str, inputs: usize, outputs: usize, stride: usize) -> Self {
        let conv = |name: &str, inputs, kernel| {
            ConvLayer::new(format!("{path}.{name}"), inputs, outputs, kernel).without_bias().kaiming()
        };
        let norm = |name: &str| BatchNorm::new(format!("{path}.{name}"), outputs);
        let changes = stride != 1 || inputs != outputs;
        Self {
            conv1: conv("conv1", inputs, 3).stride(stride),
            norm1: norm("bn1"),
            conv2: conv("conv2", outputs, 3),
            norm2: norm("bn2"),
            skip: changes.then(|| {
                let conv = conv("downsample.0", inputs, 1).stride(stride);
                (conv, norm("downsample.1"))
            }),
        }
    }

    /// Adds the tensors of the block to the list.
    pub fn declare(&self, blueprint: &mut Blueprint) {
        self.conv1.declare(blueprint);
        self.norm1.declare(blueprint);
        self.conv2.declare(blueprint);
        self.norm2.declare(blueprint);
        if let Some((conv, norm)) = &self.skip {
            conv.declare(blueprint);
            norm.declare(blueprint);
        }
    }

    /// (N, in, H, W) -> (N, out, H / stride, W / stride).
    pub fn forward<'t, T: Scalar>(&self, binder: &mut Binder<'t, T>, x: Var<'t, T>) -> Var<'t, T> {
        let skip = match &self.skip {
            None => x,
            Some((conv, norm)) => conv.forward(binder, x).last_use(|skip| norm.forward(binder, skip)),
        };
        let y = self.conv1.forward(binder, x);
        let y = y.last_use(|y| self.norm1.activated(binder, y, None, Activation::Relu));
        let y = y.last_use(|y| self.conv2.forward(binder, y));
        let y = y.last_use(|y| self.norm2.activated(binder, y, Some(skip), Activation::Relu));
        if self.skip.is_some() {
            skip.release();
        }
        y
    }
}
