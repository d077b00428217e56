//! The bottleneck block of ResNet-50.

use dimode_autodiff::{Activation, Scalar, Var};

use crate::layers::{BatchNorm, ConvLayer};
use crate::{Binder, Blueprint};

/// How much wider the output of a block is than its inside.
pub(super) const EXPANSION: usize = 4;

/// 1x1, 3x3 with the stride, 1x1 to four times the width, each with batch norm; the skip is `x`, or `BN(conv1x1_s(x))` in the
/// first block of a layer.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct FrozenBlock {
    convs: [ConvLayer; 3],
    norms: [BatchNorm; 3],
    skip: Option<(ConvLayer, BatchNorm)>,
    stride: usize,
    /// Of all three places: the reference takes all ReLUs out of the last block of a layer, not only the final one.
    activation: Activation,
}

impl FrozenBlock {
    /// The block stored under `path`, with ReLUs; it is the first of its layer when stride or width change.
    pub(super) fn new(path: &str, inputs: usize, width: usize, stride: usize) -> Self {
        let conv = |name: &str, inputs, outputs, kernel| {
            ConvLayer::new(format!("{path}.{name}"), inputs, outputs, kernel).without_bias().kaiming()
        };
        let norm = |name: &str, channels| BatchNorm::new(format!("{path}.{name}"), channels);
        let outputs = EXPANSION * width;
        let changes = stride != 1 || inputs != outputs;
        Self {
            convs: [
                conv("conv1", inputs, width, 1),
                conv("conv2", width, width, 3).stride(stride),
                conv("conv3", width, outputs, 1),
            ],
            norms: [norm("bn1", width), norm("bn2", width), norm("bn3", outputs)],
            skip: changes.then(|| (conv("downsample.0", inputs, outputs, 1).stride(stride), norm("downsample.1", outputs))),
            stride,
            activation: Activation::Relu,
        }
    }

    /// Without any ReLU.
    pub(super) fn linear(mut self) -> Self {
        self.activation = Activation::Identity;
        self
    }

    pub(super) fn declare(&self, blueprint: &mut Blueprint) {
        for (conv, norm) in self.convs.iter().zip(&self.norms).chain(self.skip.iter().map(|(conv, norm)| (conv, norm))) {
            conv.declare(blueprint);
            norm.declare(blueprint);
        }
    }

    /// (N, in, H, W) -> (N, 4 width, H / stride, W / stride).
    pub(super) fn forward<'t, T: Scalar>(&self, binder: &mut Binder<'t, T>, x: Var<'t, T>) -> Var<'t, T> {
        let skip = match &self.skip {
            None => x,
            Some((conv, norm)) => conv.forward(binder, x).last_use(|skip| norm.forward(binder, skip)),
        };
        let mut layer = |n: usize, x, skip| {
            let conv: &ConvLayer = &self.convs[n];
            conv.forward(binder, x).last_use(|y| self.norms[n].activated(binder, y, skip, self.activation))
        };
        let y = layer(0, x, None).last_use(|y| layer(1, y, None)).last_use(|y| layer(2, y, Some(skip)));
        if self.skip.is_some() {
            skip.release();
        }
        y
    }

    /// Multiply-accumulates on maps of `[height, width]`, which become those of the result.
    pub(super) fn macs(&self, map: &mut [usize; 2]) -> usize {
        let [before, after] = [*map, map.map(|side| side.div_ceil(self.stride))];
        *map = after;
        let [before, after] = [before, after].map(|[height, width]| height * width);
        let [narrow, middle, wide] = self.convs.each_ref().map(ConvLayer::macs_per_position);
        let skip = self.skip.as_ref().map_or(0, |(conv, _)| conv.macs_per_position());
        before * narrow + after * (middle + wide + skip)
    }
}
