//! ResNet encoder over one or more stacked images.

use dimode_autodiff::{Activation, Scalar, Var};

use crate::layers::{BasicBlock, BatchNorm, ConvLayer};
use crate::{Binder, Blueprint, Init};

/// Mean and deviation that the encoder takes out of every input channel.
pub(crate) const INPUT_MEAN: f64 = 0.45;
pub(crate) const INPUT_DEVIATION: f64 = 0.225;
/// Classes of the unused classifier in the reference checkpoint.
const CLASSES: usize = 1000;

/// Sizes of a ResNet encoder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ResNetConfig {
    /// Number of RGB images stacked along the channels.
    pub images: usize,
    /// Channels after the first convolution, then after each of the four layers.
    pub widths: [usize; 5],
    /// Residual blocks in each layer.
    pub blocks: [usize; 4],
    /// Whether the checkpoint carries the classifier `fc`, which is never run.
    pub classifier: bool,
}

impl ResNetConfig {
    /// ResNet-18 as in the reference checkpoints.
    pub fn resnet18(images: usize) -> Self {
        Self { images, widths: [64, 64, 128, 256, 512], blocks: [2; 4], classifier: true }
    }

    /// One block per layer and the given widths, without the classifier.
    pub fn nano(images: usize, widths: [usize; 5]) -> Self {
        Self { images, widths, blocks: [1; 4], classifier: false }
    }
}

/// A ResNet that returns its five feature maps.
#[derive(Clone, Debug, PartialEq)]
pub struct ResNetEncoder {
    root: String,
    config: ResNetConfig,
    conv1: ConvLayer,
    norm1: BatchNorm,
    layers: [Vec<BasicBlock>; 4],
}

impl ResNetEncoder {
    /// The encoder stored in the checkpoint file `file`, every name starting with `encoder.`.
    pub fn new(file: &str, config: ResNetConfig) -> Self {
        Self::under(format!("{file}:encoder"), config)
    }

    /// The encoder whose names start with the path `root`, for checkpoints that keep several modules in one file.
    pub fn under(root: String, config: ResNetConfig) -> Self {
        Self::with_stem(root, ["conv1", "bn1"], config)
    }

    /// The same, with other names of the first convolution and its norm.
    pub fn with_stem(root: String, [conv1, norm1]: [&str; 2], config: ResNetConfig) -> Self {
        let stem = config.widths[0];
        let conv1 = ConvLayer::new(format!("{root}.{conv1}"), 3 * config.images, stem, 7);
        let layer = |level: usize| {
            let (before, width) = (config.widths[level], config.widths[level + 1]);
            let block = |j: usize| {
                let path = format!("{root}.layer{}.{j}", level + 1);
                let first = j == 0;
                let inputs = if first { before } else { width };
                let stride = if first && level > 0 { 2 } else { 1 };
                BasicBlock::new(&path, inputs, width, stride)
            };
            (0..config.blocks[level]).map(block).collect()
        };
        Self {
            conv1: conv1.stride(2).without_bias().kaiming(),
            norm1: BatchNorm::new(format!("{root}.{norm1}"), stem),
            layers: std::array::from_fn(layer),
            root,
            config,
        }
    }

    /// Sizes.
    pub fn config(&self) -> &ResNetConfig {
        &self.config
    }

    /// Adds the tensors of the encoder to the list.
    pub fn declare(&self, blueprint: &mut Blueprint) {
        self.conv1.declare(blueprint);
        self.norm1.declare(blueprint);
        for block in self.layers.iter().flatten() {
            block.declare(blueprint);
        }
        if self.config.classifier {
            let (width, root) = (self.config.widths[4], format!("{}.fc", self.root));
            let init = Init::fan_in(width);
            blueprint.parameter(format!("{root}.weight"), &[CLASSES, width], init);
            blueprint.parameter(format!("{root}.bias"), &[CLASSES], init);
        }
    }

    /// Images in [0, 1], (N, 3 m, H, W) -> features at 1/2, 1/4, 1/8, 1/16 and 1/32 of the size.
    /// The first is taken before the pooling.
    ///
    /// # Panics
    /// When the number of channels is not three per image.
    #[track_caller]
    pub fn forward<'t, T: Scalar>(&self, binder: &mut Binder<'t, T>, images: Var<'t, T>) -> [Var<'t, T>; 5] {
        let channels = 3 * self.config.images;
        assert_eq!(images.shape().c(), channels, "resnet encoder: input {:?} needs {channels} channels", images.shape());
        let x = standardised(images);
        let x = x.last_use(|x| self.conv1.forward(binder, x));
        let first = x.last_use(|x| self.norm1.activated(binder, x, None, Activation::Relu));
        let mut features = [first; 5];
        let mut x = first.max_pool2d(3, 2, 1);
        for (feature, blocks) in features[1..].iter_mut().zip(&self.layers) {
            for block in blocks {
                x = block.forward(binder, x);
            }
            *feature = x;
        }
        features
    }
}

/// Images in [0, 1] with one mean and one deviation taken out of all channels.
pub(crate) fn standardised<T: Scalar>(images: Var<'_, T>) -> Var<'_, T> {
    images.add_scalar(-INPUT_MEAN).last_use(|x| x.scale(1.0 / INPUT_DEVIATION))
}
