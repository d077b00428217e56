//! Image encoder of the flow network: stem, three stages of two bottlenecks, 1x1 output.

use dimode_autodiff::{Scalar, Var};

use super::FlowNetConfig;
use crate::layers::{Bottleneck, ConvLayer, Norm};
use crate::{Binder, Blueprint};

/// The encoder used twice: for correlation features (instance norm) and for context (no norm).
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Encoder {
    conv1: ConvLayer,
    norm: Norm,
    blocks: Vec<Bottleneck>,
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
            blocks.push(Bottleneck::new(&format!("{root}.0"), inputs, width, stride, norm));
            blocks.push(Bottleneck::new(&format!("{root}.1"), width, width, 1, norm));
            inputs = width;
        }
        let conv1 = ConvLayer::new(format!("{path}.conv1"), 3, config.stem, 7);
        Self {
            conv1: conv1.stride(2).kaiming(),
            norm,
            blocks,
            conv2: ConvLayer::new(format!("{path}.conv2"), inputs, outputs, 1).kaiming(),
        }
    }

    pub(super) fn declare(&self, blueprint: &mut Blueprint) {
        self.conv1.declare(blueprint);
        self.blocks.iter().for_each(|b| b.declare(blueprint));
        self.conv2.declare(blueprint);
    }

    /// Images in [-1, 1], (N, 3, H, W) -> (N, outputs, H / factor, W / factor).
    pub(super) fn forward<'t, T: Scalar>(&self, binder: &Binder<'t, T>, images: Var<'t, T>) -> Var<'t, T> {
        let x = self.conv1.forward(binder, images);
        let mut x = self.norm.forward(x).last_use(Var::relu);
        for block in &self.blocks {
            x = x.last_use(|x| block.forward(binder, x));
        }
        x.last_use(|x| self.conv2.forward(binder, x))
    }
}
