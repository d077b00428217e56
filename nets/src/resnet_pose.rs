//! Relative pose from two stacked images: ResNet encoder and pose decoder.

use dimode_autodiff::{Scalar, Var};

use crate::{Binder, Blueprint, Network, PoseDecoder, ResNetConfig, ResNetEncoder, UnfitSize, size};

/// Sizes of a [`ResNetPose`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ResNetPoseConfig {
    /// The encoder, on two images.
    pub encoder: ResNetConfig,
    /// Channels inside the pose decoder.
    pub decoder: usize,
    /// Poses predicted; only the first is used, the second exists in the reference checkpoints.
    pub frames: usize,
}

impl ResNetPoseConfig {
    /// 394 700 parameters: for tests and small machines.
    pub fn nano() -> Self {
        Self { encoder: ResNetConfig::nano(2, [16, 16, 32, 64, 128]), decoder: 64, frames: 2 }
    }

    /// The size of the reference checkpoints.
    pub fn resnet18() -> Self {
        Self { encoder: ResNetConfig::resnet18(2), decoder: 256, frames: 2 }
    }
}

/// Encoder in the file `pose_encoder`, decoder in the file `pose`.
#[derive(Clone, Debug, PartialEq)]
pub struct ResNetPose {
    encoder: ResNetEncoder,
    decoder: PoseDecoder,
}

impl ResNetPose {
    /// The network of the given sizes.
    pub fn new(config: ResNetPoseConfig) -> Self {
        let inputs = config.encoder.widths[4];
        Self {
            encoder: ResNetEncoder::new("pose_encoder", config.encoder),
            decoder: PoseDecoder::new("pose", inputs, config.decoder, config.frames),
        }
    }

    /// Whether images of `height` rows and `width` columns fit: all that are not empty, since the mean over the coarsest map
    /// takes any size.
    ///
    /// # Errors
    /// [`UnfitSize`] when they do not.
    pub fn check_size(&self, height: usize, width: usize) -> Result<(), UnfitSize> {
        size::fits("the ResNet pose network", (1, 1), (height, width))
    }

    /// Two images in [0, 1], each (N, 3, H, W), the earlier first -> five features of the stack.
    ///
    /// # Panics
    /// When an image has not three channels, is empty or the two differ in size.
    #[track_caller]
    pub fn features<'t, T: Scalar>(&self, binder: &mut Binder<'t, T>, first: Var<'t, T>, second: Var<'t, T>) -> [Var<'t, T>; 5] {
        self.check_size(first.shape().h(), first.shape().w()).unwrap_or_else(|unfit| panic!("{unfit}"));
        let pair = Var::concat(&[first, second], 1);
        let features = self.encoder.forward(binder, pair);
        pair.release();
        features
    }

    /// Coarsest feature -> (N, 6 frames, 1, 1), scaled by 0.01.
    pub fn decode<'t, T: Scalar>(&self, binder: &Binder<'t, T>, feature: Var<'t, T>) -> Var<'t, T> {
        self.decoder.forward(binder, feature)
    }
}

impl Network for ResNetPose {
    fn blueprint(&self) -> Blueprint {
        let mut blueprint = Blueprint::new();
        self.encoder.declare(&mut blueprint);
        self.decoder.declare(&mut blueprint);
        blueprint
    }
}
