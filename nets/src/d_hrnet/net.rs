//! Encoder and decoder of D-HRNet together.

use dimode_autodiff::{Scalar, Var};

use super::DHrNetConfig;
use super::decoder::Decoder;
use super::encoder::Encoder;
use crate::size::fits;
use crate::{Binder, Blueprint, Network, UnfitSize};

/// Depth from one image: encoder in the file `encoder`, decoder in the file `depth`.
#[derive(Clone, Debug, PartialEq)]
pub struct DHrNet {
    encoder: Encoder,
    decoder: Decoder,
}

impl DHrNet {
    /// The network of the given sizes.
    pub fn new(config: DHrNetConfig) -> Self {
        Self { encoder: Encoder::new("encoder", &config), decoder: Decoder::new("depth", &config) }
    }

    /// Whether images of this height and width can be taken.
    ///
    /// **Errors** unless both are multiples of 32, at least 64: the coarsest map is reflected at its border.
    pub fn check_size(&self, height: usize, width: usize) -> Result<(), UnfitSize> {
        fits("D-HRNet", (32, 64), (height, width))
    }

    /// Images in [0, 1], (N, 3, H, W) -> five features at 1/2 to 1/32 of the size.
    ///
    /// # Panics
    /// When the size does not fit, see [`DHrNet::check_size`].
    #[track_caller]
    pub fn features<'t, T: Scalar>(&self, binder: &mut Binder<'t, T>, images: Var<'t, T>) -> [Var<'t, T>; 5] {
        let shape = images.shape();
        if let Err(unfit) = self.check_size(shape.h(), shape.w()) {
            panic!("{unfit}");
        }
        self.encoder.forward(binder, images)
    }

    /// Features -> the disparity in (0, 1), (N, 1, H, W).
    pub fn decode<'t, T: Scalar>(&self, binder: &Binder<'t, T>, features: &[Var<'t, T>; 5]) -> Var<'t, T> {
        self.decoder.forward(binder, features)
    }
}

impl Network for DHrNet {
    fn blueprint(&self) -> Blueprint {
        let mut blueprint = Blueprint::new();
        self.encoder.declare(&mut blueprint);
        self.decoder.declare(&mut blueprint);
        blueprint
    }
}
