//! Features that nothing trains, to be correlated between two images.

use dimode_autodiff::{Activation, Scalar, Var};

use super::ScipadConfig;
use super::frozen_block::{EXPANSION, FrozenBlock};
use crate::layers::{BatchNorm, ConvLayer};
use crate::resnet_encoder::{INPUT_DEVIATION, INPUT_MEAN};
use crate::{Binder, Blueprint, Mode};

/// Guard of the norm that features are divided by.
const NORM_EPSILON: f64 = 1e-12;

/// A ResNet of bottlenecks whose last block in each layer has no ReLUs. All its parameters are [`crate::Kind::Frozen`]; its
/// running statistics move in training like those of the trained layers.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct FrozenExtractor {
    conv1: ConvLayer,
    norm1: BatchNorm,
    layers: [Vec<FrozenBlock>; 4],
}

impl FrozenExtractor {
    pub(super) fn new(path: &str, config: &ScipadConfig) -> Self {
        let conv1 = ConvLayer::new(format!("{path}.layer0.0"), 3, config.frozen_stem, 7);
        let layer = |level: usize| {
            let (width, count) = (config.frozen_widths[level], config.frozen_blocks[level]);
            let before = if level == 0 { config.frozen_stem } else { EXPANSION * config.frozen_widths[level - 1] };
            let block = |j: usize| {
                let path = format!("{path}.layer{}.{j}", level + 1);
                let inputs = if j == 0 { before } else { EXPANSION * width };
                let stride = if j == 0 && level > 0 { 2 } else { 1 };
                let block = FrozenBlock::new(&path, inputs, width, stride);
                if j + 1 == count { block.linear() } else { block }
            };
            (0..count).map(block).collect()
        };
        Self {
            conv1: conv1.stride(2).without_bias().kaiming(),
            norm1: BatchNorm::new(format!("{path}.layer0.1"), config.frozen_stem),
            layers: std::array::from_fn(layer),
        }
    }

    pub(super) fn declare(&self, blueprint: &mut Blueprint) {
        blueprint.frozen(|part| {
            self.conv1.declare(part);
            self.norm1.declare(part);
            self.layers.iter().flatten().for_each(|block| block.declare(part));
        });
    }

    /// Images in [0, 1], (N, 3, H, W) -> features of unit length at 1/4, 1/8 and 1/16 of the size. No gradient passes.
    ///
    /// Nothing reads what the fourth layer says. It runs in training only, where its running statistics move; else its
    /// multiply-accumulates are counted, since the definition has them.
    pub(super) fn forward<'t, T: Scalar>(&self, binder: &mut Binder<'t, T>, images: Var<'t, T>) -> [Var<'t, T>; 3] {
        // Cut off from the images, all of this is constant, and the tape keeps nothing of it for a way back.
        let x = images.detach().last_use(|x| x.add_scalar(-INPUT_MEAN)).last_use(|x| x.scale(1.0 / INPUT_DEVIATION));
        let x = x.last_use(|x| self.conv1.forward(binder, x));
        let x = x.last_use(|x| self.norm1.activated(binder, x, None, Activation::Relu));
        let mut x = x.last_use(|x| x.max_pool2d(3, 2, 1));
        let [fine @ .., last] = &self.layers;
        let features = fine.each_ref().map(|blocks| {
            for block in blocks.iter() {
                x = x.last_use(|x| block.forward(binder, x));
            }
            let feature = x.l2_normalise(1, NORM_EPSILON);
            x = x.last_use(Var::relu);
            feature
        });
        match binder.mode() {
            Mode::Train => {
                for block in last {
                    x = x.last_use(|x| block.forward(binder, x));
                }
            }
            Mode::Eval => {
                let mut map = [x.shape().h(), x.shape().w()];
                let macs: usize = last.iter().map(|block| block.macs(&mut map)).sum();
                binder.count_macs(x.shape().n() * macs);
            }
        }
        x.release();
        features
    }
}
