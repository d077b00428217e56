//! The three-convolution residual block of HRNet's first layer.

use dimode_autodiff::{Activation, Scalar, Var};

use super::conv_norm::ConvNorm;
use crate::{Binder, Blueprint};

/// Outputs of a bottleneck for each of its inner channels.
pub(super) const EXPANSION: usize = 4;

/// `ReLU(BN3(conv1x1(ReLU(BN2(conv3x3(ReLU(BN1(conv1x1(x)))))))) + skip)`, where the skip is `x`, or `BN(conv1x1(x))` when the
/// width changes.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Bottleneck {
    convs: [ConvNorm; 3],
    skip: Option<ConvNorm>,
}

impl Bottleneck {
    /// The block stored under `path`, with `inner` channels inside.
    pub(super) fn new(path: &str, inputs: usize, inner: usize) -> Self {
        let outputs = EXPANSION * inner;
        let conv =
            |n: usize, channels, kernel| ConvNorm::new(format!("{path}.conv{n}"), format!("{path}.bn{n}"), channels, kernel, 1);
        Self {
            convs: [conv(1, [inputs, inner], 1), conv(2, [inner, inner], 3), conv(3, [inner, outputs], 1)],
            skip: (inputs != outputs).then(|| ConvNorm::pair(&format!("{path}.downsample"), [inputs, outputs], 1, 1)),
        }
    }

    pub(super) fn declare(&self, blueprint: &mut Blueprint) {
        self.convs.iter().chain(&self.skip).for_each(|conv| conv.declare(blueprint));
    }

    /// (N, in, H, W) -> (N, 4 inner, H, W); gives up the value of `x`.
    pub(super) fn forward<'t, T: Scalar>(&self, binder: &mut Binder<'t, T>, x: Var<'t, T>) -> Var<'t, T> {
        let skip = match &self.skip {
            None => x,
            Some(conv) => conv.forward(binder, x, Activation::Identity),
        };
        let [narrow, middle, wide] = &self.convs;
        let y = narrow.forward(binder, x, Activation::Relu);
        let y = y.last_use(|y| middle.forward(binder, y, Activation::Relu));
        let y = y.last_use(|y| wide.joined(binder, y, Some(skip), Activation::Relu));
        if self.skip.is_some() {
            skip.release();
        }
        x.release();
        y
    }
}
