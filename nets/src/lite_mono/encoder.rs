//! The encoder of Lite-Mono.

use dimode_autodiff::{Scalar, Var};

use super::LiteMonoConfig;
use super::cdc_block::CdcBlock;
use super::lgfi_block::LgfiBlock;
use crate::layers::{BatchNorm, ConvLayer};
use crate::resnet_encoder::standardised;
use crate::{Binder, Blueprint};

/// Colours of an image, joined to the features at every halving.
const COLOURS: usize = 3;

/// Convolution blocks of one dilation each, then an attention block.
#[derive(Clone, Debug, PartialEq)]
struct Stage {
    convolutions: Vec<CdcBlock>,
    attention: LgfiBlock,
}

/// Three stages at 1/4, 1/8 and 1/16 of the size.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Encoder {
    stem: [(ConvLayer, BatchNorm); 3],
    /// Halvings before the three stages.
    halvings: [ConvLayer; 3],
    stages: [Stage; 3],
}

impl Encoder {
    /// The encoder stored in the checkpoint file `file`.
    pub(super) fn new(file: &str, config: &LiteMonoConfig) -> Self {
        let [first, second, third] = config.dims;
        let conv = |path: &str, inputs, outputs| {
            ConvLayer::new(format!("{file}:{path}.conv"), inputs, outputs, 3).without_bias().kaiming()
        };
        let stem = |i: usize| {
            let path = format!("downsample_layers.0.{i}");
            let (inputs, stride) = if i == 0 { (COLOURS, 2) } else { (first, 1) };
            let norm = BatchNorm::new(format!("{file}:{path}.bn_gelu.bn"), first);
            (conv(&path, inputs, first).stride(stride), norm)
        };
        Self {
            stem: std::array::from_fn(stem),
            halvings: [
                conv("stem2.0", first + COLOURS, first).stride(2),
                conv("downsample_layers.1.0", 2 * first + COLOURS, second).stride(2),
                conv("downsample_layers.2.0", 2 * second + COLOURS, third).stride(2),
            ],
            stages: std::array::from_fn(|i| Stage::new(file, i, config)),
        }
    }

    pub(super) fn declare(&self, blueprint: &mut Blueprint) {
        for (conv, norm) in &self.stem {
            conv.declare(blueprint);
            norm.declare(blueprint);
        }
        for (halving, stage) in self.halvings.iter().zip(&self.stages) {
            halving.declare(blueprint);
            stage.convolutions.iter().for_each(|block| block.declare(blueprint));
            stage.attention.declare(blueprint);
        }
    }

    /// Images in [0, 1], (N, 3, H, W) -> features at 1/4, 1/8 and 1/16 of the size.
    pub(super) fn forward<'t, T: Scalar>(&self, binder: &mut Binder<'t, T>, images: Var<'t, T>) -> [Var<'t, T>; 3] {
        let mut image = standardised(images);
        let mut x = image;
        for (i, (conv, norm)) in self.stem.iter().enumerate() {
            let y = conv.forward(binder, x);
            if i > 0 {
                x.release();
            }
            x = y.last_use(|y| norm.forward(binder, y)).last_use(Var::gelu);
        }
        let mut parts = vec![x];
        let mut features = [x; 3];
        for ((feature, halving), stage) in features.iter_mut().zip(&self.halvings).zip(&self.stages) {
            // The mean of nine pixels; those beyond the border count as zeros.
            image = image.last_use(|image| image.avg_pool2d(3, 2, 1));
            parts.push(image);
            let joined = Var::concat(&parts, 1);
            // What goes on is the last feature, which the decoder asks for, and before it the map that the stage began with.
            parts[0].release();
            let start = joined.last_use(|joined| halving.forward(binder, joined));
            *feature = stage.forward(binder, start);
            parts = vec![start, *feature];
        }
        image.release();
        parts[0].release();
        features
    }
}

impl Stage {
    fn new(file: &str, stage: usize, config: &LiteMonoConfig) -> Self {
        let LiteMonoConfig { dims, dilations, heads, expansion, .. } = config;
        let before: usize = dilations[..stage].iter().map(|stage| stage.len() + 1).sum();
        let path = |block: usize| format!("{file}:stages.{stage}.{block}");
        let rate = |block: usize| config.drop_rate(before + block);
        let channels = dims[stage];
        let convolution = |(j, &dilation)| CdcBlock::new(&path(j), channels, dilation, *expansion, rate(j));
        let last = dilations[stage].len();
        let attention = LgfiBlock::new(&path(last), channels, *heads, *expansion, rate(last));
        Self {
            convolutions: dilations[stage].iter().enumerate().map(convolution).collect(),
            attention: if stage == 0 { attention.with_code(&path(last), channels) } else { attention },
        }
    }

    /// (N, C, H, W) -> the same.
    fn forward<'t, T: Scalar>(&self, binder: &mut Binder<'t, T>, start: Var<'t, T>) -> Var<'t, T> {
        let mut x = start;
        for (i, block) in self.convolutions.iter().enumerate() {
            let y = block.forward(binder, x);
            if i > 0 {
                x.release();
            }
            x = y;
        }
        let y = self.attention.forward(binder, x);
        if !self.convolutions.is_empty() {
            x.release();
        }
        y
    }
}
