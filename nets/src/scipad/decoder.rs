//! From the fused feature map to six numbers.

use dimode_autodiff::{Activation, Scalar, Var};

use crate::layers::{ConvLayer, LinearLayer};
use crate::pose_decoder::OUTPUT_SCALE;
use crate::{Binder, Blueprint};

/// A convolution, the mean over the map, two linear layers and a factor 0.01.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Decoder {
    squeeze: ConvLayer,
    hidden: LinearLayer,
    output: LinearLayer,
}

impl Decoder {
    pub(super) fn new(path: &str, inputs: usize, squeeze: usize, hidden: usize) -> Self {
        Self {
            squeeze: ConvLayer::new(format!("{path}.conv_squeeze"), inputs, squeeze, 1),
            hidden: LinearLayer::new(format!("{path}.mlp.0"), squeeze, hidden),
            output: LinearLayer::new(format!("{path}.mlp.2"), hidden, 6),
        }
    }

    pub(super) fn declare(&self, blueprint: &mut Blueprint) {
        self.squeeze.declare(blueprint);
        self.hidden.declare(blueprint);
        self.output.declare(blueprint);
    }

    /// (N, inputs, h, w) -> (N, 6, 1, 1): the axis-angle vector, then the translation.
    pub(super) fn forward<'t, T: Scalar>(&self, binder: &Binder<'t, T>, feature: Var<'t, T>) -> Var<'t, T> {
        let x = self.squeeze.activated(binder, feature, Activation::Relu).last_use(Var::mean_hw);
        let x = x.last_use(|x| self.hidden.forward(binder, x)).last_use(Var::relu);
        let x = x.last_use(|x| self.output.forward(binder, x));
        x.last_use(|x| x.scale(OUTPUT_SCALE))
    }
}
