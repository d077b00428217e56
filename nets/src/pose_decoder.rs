//! Pose decoder: from the coarsest feature map to six numbers per predicted frame.

use dimode_autodiff::{Activation, Scalar, Var};

use crate::layers::ConvLayer;
use crate::{Binder, Blueprint};

/// Factor on the raw output, so that a fresh network predicts small motions.
pub(crate) const OUTPUT_SCALE: f64 = 0.01;

/// Four convolutions, the mean over the map, and a factor 0.01.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseDecoder {
    convs: [ConvLayer; 4],
}

impl PoseDecoder {
    /// The decoder stored in the checkpoint file `file`: `inputs` channels in, `width` inside,
    /// 6 numbers for each of `frames` frames out.
    pub fn new(file: &str, inputs: usize, width: usize, frames: usize) -> Self {
        let conv = |n: usize, inputs, outputs, kernel| ConvLayer::new(format!("{file}:net.{n}"), inputs, outputs, kernel);
        Self {
            convs: [conv(0, inputs, width, 1), conv(1, width, width, 3), conv(2, width, width, 3), conv(3, width, 6 * frames, 1)],
        }
    }

    /// Adds the tensors of the decoder to the list.
    pub fn declare(&self, blueprint: &mut Blueprint) {
        self.convs.iter().for_each(|conv| conv.declare(blueprint));
    }

    /// (N, inputs, h, w) -> (N, 6 frames, 1, 1): for each frame the axis-angle vector, then the
    /// translation.
    pub fn forward<'t, T: Scalar>(&self, binder: &Binder<'t, T>, feature: Var<'t, T>) -> Var<'t, T> {
        let [squeeze, first, second, last] = &self.convs;
        let x = squeeze.activated(binder, feature, Activation::Relu);
        let x = x.last_use(|x| first.activated(binder, x, Activation::Relu));
        let x = x.last_use(|x| second.activated(binder, x, Activation::Relu));
        x.last_use(|x| last.forward(binder, x)).last_use(Var::mean_hw).scale(OUTPUT_SCALE)
    }
}
