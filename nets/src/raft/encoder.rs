//! Image encoder of the flow network: stem, three stages of two blocks, 1x1 output.

use dimode_autodiff::{Scalar, Var};

use super::{FlowNetConfig, RaftVariant};
use crate::layers::{Bottleneck, ConvLayer, Norm, NormLayer, ResidualBlock};
use crate::{Binder, Blueprint};

/// A block of a stage.
#[derive(Clone, Debug, PartialEq)]
enum Block {
    Narrow(Bottleneck),
    Wide(ResidualBlock),
}

impl Block {
    fn new(variant: RaftVariant, path: &str, (inputs, outputs): (usize, usize), stride: usize, norm: Norm) -> Self {
        match variant {
            RaftVariant::Small => Self::Narrow(Bottleneck::new(path, inputs, outputs, stride, norm)),
            RaftVariant::Full(_) => Self::Wide(ResidualBlock::new(path, inputs, outputs, stride, norm)),
        }
    }

    fn declare(&self, blueprint: &mut Blueprint) {
        match self {
            Self::Narrow(block) => block.declare(blueprint),
            Self::Wide(block) => block.declare(blueprint),
        }
    }

    fn forward<'t, T: Scalar>(&self, binder: &mut Binder<'t, T>, x: Var<'t, T>) -> Var<'t, T> {
        match self {
            Self::Narrow(block) => block.forward(binder, x),
            Self::Wide(block) => block.forward(binder, x),
        }
    }
}

/// The encoder used twice: for correlation features (instance norm) and for context (batch norm, or none in the small network).
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Encoder {
    conv1: ConvLayer,
    norm1: NormLayer,
    blocks: Vec<Block>,
    conv2: ConvLayer,
}

impl Encoder {
    /// The encoder stored under `path`.
    pub(super) fn new(path: &str, config: &FlowNetConfig, outputs: usize, norm: Norm) -> Self {
        let mut blocks = Vec::with_capacity(6);
        let mut inputs = config.stem;
        let strides = [1, 2, config.last_stride];
        for (level, (width, stride)) in config.stages.into_iter().zip(strides).enumerate() {
            let root = format!("{path}.layer{}", level + 1);
            blocks.push(Block::new(config.variant, &format!("{root}.0"), (inputs, width), stride, norm));
            blocks.push(Block::new(config.variant, &format!("{root}.1"), (width, width), 1, norm));
            inputs = width;
        }
        let conv1 = ConvLayer::new(format!("{path}.conv1"), 3, config.stem, 7);
        Self {
            conv1: conv1.stride(2).kaiming(),
            norm1: norm.layer(format!("{path}.norm1"), config.stem),
            blocks,
            conv2: ConvLayer::new(format!("{path}.conv2"), inputs, outputs, 1).kaiming(),
        }
    }

    pub(super) fn declare(&self, blueprint: &mut Blueprint) {
        self.norm1.declare(blueprint);
        self.conv1.declare(blueprint);
        self.blocks.iter().for_each(|b| b.declare(blueprint));
        self.conv2.declare(blueprint);
    }

    /// Images in [-1, 1], (N, 3, H, W) -> (N, outputs, H / factor, W / factor).
    pub(super) fn forward<'t, T: Scalar>(&self, binder: &mut Binder<'t, T>, images: Var<'t, T>) -> Var<'t, T> {
        let x = self.conv1.forward(binder, images);
        let mut x = self.norm1.relu(binder, x);
        for block in &self.blocks {
            x = x.last_use(|x| block.forward(binder, x));
        }
        x.last_use(|x| self.conv2.forward(binder, x))
    }
}
