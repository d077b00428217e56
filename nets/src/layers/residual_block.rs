//! The wide residual block of the full RAFT encoders.

use dimode_autodiff::{Scalar, Var};

use super::bottleneck::skip_and_rectify;
use super::{ConvLayer, Norm, NormLayer};
use crate::{Binder, Blueprint};

/// 3x3 with the stride, then 3x3, each followed by norm and ReLU; then `ReLU(skip + y)`. Unlike the block of ResNet-18 there is
/// a ReLU on `y` before the sum, and the convolutions have biases.
///
/// The norm of the skip is called `norm3`. The reference registers it a second time as `downsample.1`.
#[derive(Clone, Debug, PartialEq)]
pub struct ResidualBlock {
    convs: [ConvLayer; 2],
    norms: [NormLayer; 2],
    skip: Option<(ConvLayer, NormLayer)>,
}

impl ResidualBlock {
    /// The block stored under `path`. A skip convolution exists where stride or width change.
    pub fn new(path: &str, inputs: usize, outputs: usize, stride: usize, norm: Norm) -> Self {
        let conv = |name: &str, inputs, kernel| ConvLayer::new(format!("{path}.{name}"), inputs, outputs, kernel).kaiming();
        let norm = |n: usize| norm.layer(format!("{path}.norm{n}"), outputs);
        let changes = stride != 1 || inputs != outputs;
        Self {
            convs: [conv("conv1", inputs, 3).stride(stride), conv("conv2", outputs, 3)],
            norms: [norm(1), norm(2)],
            skip: changes.then(|| (conv("downsample.0", inputs, 1).stride(stride), norm(3))),
        }
    }

    /// Adds the tensors of the block to the list.
    pub fn declare(&self, blueprint: &mut Blueprint) {
        self.convs.iter().for_each(|conv| conv.declare(blueprint));
        self.norms.iter().for_each(|norm| norm.declare(blueprint));
        if let Some((conv, norm)) = &self.skip {
            norm.declare(blueprint);
            conv.declare(blueprint);
        }
    }

    /// (N, in, H, W) -> (N, out, H / stride, W / stride).
    pub fn forward<'t, T: Scalar>(&self, binder: &mut Binder<'t, T>, x: Var<'t, T>) -> Var<'t, T> {
        let mut layer = |n: usize, x| {
            let y = self.convs[n].forward(binder, x);
            self.norms[n].relu(binder, y)
        };
        let y = layer(0, x).last_use(|y| layer(1, y));
        skip_and_rectify(binder, self.skip.as_ref(), x, y)
    }
}
