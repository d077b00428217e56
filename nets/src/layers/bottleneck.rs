//! The narrow residual block of the small RAFT encoders.

use dimode_autodiff::{Scalar, Var};

use super::ConvLayer;
use crate::{Binder, Blueprint};

/// Added to the variance of instance normalisation.
const EPSILON: f64 = 1e-5;

/// Normalisation after a convolution, without parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Norm {
    /// None.
    None,
    /// Per image and channel over height and width, the same in training and evaluation.
    Instance,
}

impl Norm {
    /// (N, C, H, W) -> the same; gives up the value of `x`.
    pub fn forward<'t, T: Scalar>(self, x: Var<'t, T>) -> Var<'t, T> {
        match self {
            Self::None => x,
            Self::Instance => x.last_use(|x| x.instance_norm(EPSILON)),
        }
    }
}

/// 1x1 to a quarter of the width, 3x3 with the stride, 1x1 to the full width, each followed by
/// norm and ReLU; then `ReLU(skip + y)`. Note the ReLU on `y` before the sum.
#[derive(Clone, Debug, PartialEq)]
pub struct Bottleneck {
    convs: [ConvLayer; 3],
    skip: Option<ConvLayer>,
    norm: Norm,
}

impl Bottleneck {
    /// The block stored under `path`. A skip convolution exists where stride or width change.
    pub fn new(path: &str, inputs: usize, outputs: usize, stride: usize, norm: Norm) -> Self {
        let conv =
            |name: &str, inputs, outputs, kernel| ConvLayer::new(format!("{path}.{name}"), inputs, outputs, kernel).kaiming();
        let narrow = outputs / 4;
        let changes = stride != 1 || inputs != outputs;
        Self {
            convs: [
                conv("conv1", inputs, narrow, 1),
                conv("conv2", narrow, narrow, 3).stride(stride),
                conv("conv3", narrow, outputs, 1),
            ],
            skip: changes.then(|| conv("downsample.0", inputs, outputs, 1).stride(stride)),
            norm,
        }
    }

    /// Adds the tensors of the block to the list.
    pub fn declare(&self, blueprint: &mut Blueprint) {
        self.convs.iter().for_each(|conv| conv.declare(blueprint));
        if let Some(conv) = &self.skip {
            conv.declare(blueprint);
        }
    }

    /// (N, in, H, W) -> (N, out, H / stride, W / stride).
    pub fn forward<'t, T: Scalar>(&self, binder: &Binder<'t, T>, x: Var<'t, T>) -> Var<'t, T> {
        let layer = |conv: &ConvLayer, x| self.norm.forward(conv.forward(binder, x)).last_use(Var::relu);
        let [first, second, third] = &self.convs;
        let y = layer(first, x).last_use(|y| layer(second, y)).last_use(|y| layer(third, y));
        let sum = match &self.skip {
            None => y.last_use(|y| x.add(y)),
            Some(conv) => y.last_use(|y| self.norm.forward(conv.forward(binder, x)).last_use(|skip| skip.add(y))),
        };
        sum.last_use(Var::relu)
    }
}
