//! Encoder and decoder of Lite-Mono together.

use dimode_autodiff::{Scalar, Var};

use super::LiteMonoConfig;
use super::decoder::Decoder;
use super::encoder::Encoder;
use crate::size::fits;
use crate::{Binder, Blueprint, Network, UnfitSize};

/// Depth from one image: encoder in the file `encoder`, decoder in the file `depth`.
#[derive(Clone, Debug, PartialEq)]
pub struct LiteMono {
    encoder: Encoder,
    decoder: Decoder,
}

impl LiteMono {
    /// The network of the given sizes.
    ///
    /// # Panics
    /// When the channels of a stage do not make equal heads.
    #[track_caller]
    pub fn new(config: LiteMonoConfig) -> Self {
        Self { encoder: Encoder::new("encoder", &config), decoder: Decoder::new("depth", &config) }
    }

    /// Whether images of this height and width can be taken.
    ///
    /// **Errors** unless both are multiples of 16, at least 32: the coarsest map is reflected at its border.
    pub fn check_size(&self, height: usize, width: usize) -> Result<(), UnfitSize> {
        fits("Lite-Mono", (16, 32), (height, width))
    }

    /// Number of disparities.
    pub fn scales(&self) -> usize {
        self.decoder.scales()
    }

    /// Images in [0, 1], (N, 3, H, W) -> three features at 1/4, 1/8 and 1/16 of the size.
    ///
    /// # Panics
    /// When the size does not fit, see [`LiteMono::check_size`].
    #[track_caller]
    pub fn features<'t, T: Scalar>(&self, binder: &mut Binder<'t, T>, images: Var<'t, T>) -> [Var<'t, T>; 3] {
        let shape = images.shape();
        if let Err(unfit) = self.check_size(shape.h(), shape.w()) {
            panic!("{unfit}");
        }
        self.encoder.forward(binder, images)
    }

    /// Features -> disparities in (0, 1), finest first.
    pub fn decode<'t, T: Scalar>(&self, binder: &Binder<'t, T>, features: &[Var<'t, T>; 3]) -> Vec<Var<'t, T>> {
        self.decoder.forward(binder, features)
    }
}

impl Network for LiteMono {
    fn blueprint(&self) -> Blueprint {
        let mut blueprint = Blueprint::new();
        self.encoder.declare(&mut blueprint);
        self.decoder.declare(&mut blueprint);
        blueprint
    }
}
