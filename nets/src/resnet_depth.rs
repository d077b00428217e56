//! Depth from one image: ResNet encoder and skip-connection decoder.

use dimode_autodiff::{Scalar, Var};

use crate::size::fits;
use crate::{Binder, Blueprint, DepthDecoder, Network, ResNetConfig, ResNetEncoder, UnfitSize};

/// Sizes of a [`ResNetDepth`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ResNetDepthConfig {
    /// The encoder, on one image.
    pub encoder: ResNetConfig,
    /// Decoder channels at levels 0 (full size) to 4.
    pub decoder: [usize; 5],
    /// Levels with a disparity output.
    pub scales: Vec<usize>,
}

impl ResNetDepthConfig {
    /// 134 204 parameters: for tests and small machines.
    pub fn nano() -> Self {
        Self { encoder: ResNetConfig::nano(1, [8, 8, 16, 32, 64]), decoder: [8, 8, 16, 16, 32], scales: vec![0, 1, 2, 3] }
    }

    /// The size of the reference checkpoints.
    pub fn resnet18() -> Self {
        Self { encoder: ResNetConfig::resnet18(1), decoder: [16, 32, 64, 128, 256], scales: vec![0, 1, 2, 3] }
    }
}

/// Encoder in the file `encoder`, decoder in the file `depth`.
#[derive(Clone, Debug, PartialEq)]
pub struct ResNetDepth {
    encoder: ResNetEncoder,
    decoder: DepthDecoder,
}

impl ResNetDepth {
    /// The network of the given sizes.
    pub fn new(config: ResNetDepthConfig) -> Self {
        let widths = config.encoder.widths;
        Self {
            encoder: ResNetEncoder::new("encoder", config.encoder),
            decoder: DepthDecoder::new("depth", widths, config.decoder, &config.scales),
        }
    }

    /// Whether images of this height and width can be taken.
    ///
    /// **Errors** unless both are multiples of 32, at least 64: the coarsest map must have at least two rows and columns to be
    /// reflected at its border.
    pub fn check_size(&self, height: usize, width: usize) -> Result<(), UnfitSize> {
        fits("the ResNet depth network", (32, 64), (height, width))
    }

    /// Number of disparities.
    pub fn scales(&self) -> usize {
        self.decoder.scales()
    }

    /// Images in [0, 1], (N, 3, H, W) -> five features, fine to coarse.
    ///
    /// # Panics
    /// When the size does not fit, see [`ResNetDepth::check_size`].
    #[track_caller]
    pub fn features<'t, T: Scalar>(&self, binder: &mut Binder<'t, T>, images: Var<'t, T>) -> [Var<'t, T>; 5] {
        let shape = images.shape();
        if let Err(unfit) = self.check_size(shape.h(), shape.w()) {
            panic!("{unfit}");
        }
        self.encoder.forward(binder, images)
    }

    /// Features -> disparities in (0, 1), finest first.
    pub fn decode<'t, T: Scalar>(&self, binder: &Binder<'t, T>, features: &[Var<'t, T>; 5]) -> Vec<Var<'t, T>> {
        self.decoder.forward(binder, features)
    }
}

impl Network for ResNetDepth {
    fn blueprint(&self) -> Blueprint {
        let mut blueprint = Blueprint::new();
        self.encoder.declare(&mut blueprint);
        self.decoder.declare(&mut blueprint);
        blueprint
    }
}
