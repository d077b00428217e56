//! Sizes of the SCIPaD pose network.

use crate::ResNetConfig;

/// Sizes of a [`super::ScipadPose`]; all counts are channels unless said otherwise.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ScipadConfig {
    /// The trained encoder, on two images.
    pub semantic: ResNetConfig,
    /// First convolution of the frozen encoder.
    pub frozen_stem: usize,
    /// Inner width of the blocks in the four layers of the frozen encoder; its features are four times as wide.
    pub frozen_widths: [usize; 4],
    /// Blocks in each layer of the frozen encoder.
    pub frozen_blocks: [usize; 4],
    /// Positional features.
    pub embedding: usize,
    /// First layer of the decoder, a convolution.
    pub squeeze: usize,
    /// Hidden layer of the decoder behind the mean over the map.
    pub hidden: usize,
}

impl ScipadConfig {
    /// The size of the reference: 36.5 million parameters, of which 23.5 million are frozen.
    pub fn scipad() -> Self {
        Self {
            semantic: ResNetConfig { classifier: false, ..ResNetConfig::resnet18(2) },
            frozen_stem: 64,
            frozen_widths: [64, 128, 256, 512],
            frozen_blocks: [3, 4, 6, 3],
            embedding: 96,
            squeeze: 256,
            hidden: 64,
        }
    }

    /// 148 986 parameters: for tests of the code. A frozen encoder of random weights says nothing about accuracy.
    pub fn nano() -> Self {
        Self {
            semantic: ResNetConfig::nano(2, [8, 8, 16, 32, 64]),
            frozen_stem: 8,
            frozen_widths: [4, 8, 16, 32],
            frozen_blocks: [2, 2, 2, 1],
            embedding: 16,
            squeeze: 32,
            hidden: 16,
        }
    }
}
