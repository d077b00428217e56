//! From the fused feature map to six numbers.

use dimode_autodiff::{Activation, Conv2d, Scalar, Shape, Var};

use crate::layers::ConvLayer;
use crate::pose_decoder::OUTPUT_SCALE;
use crate::{Binder, Blueprint, Init};

/// A convolution, the mean over the map, two linear layers and a factor 0.01.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Decoder {
    squeeze: ConvLayer,
    hidden: Dense,
    output: Dense,
}

impl Decoder {
    pub(super) fn new(path: &str, inputs: usize, squeeze: usize, hidden: usize) -> Self {
        Self {
            squeeze: ConvLayer::new(format!("{path}.conv_squeeze"), inputs, squeeze, 1),
            hidden: Dense { path: format!("{path}.mlp.0"), inputs: squeeze, outputs: hidden },
            output: Dense { path: format!("{path}.mlp.2"), inputs: hidden, outputs: 6 },
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
        let x = x.last_use(|x| self.hidden.activated(binder, x, Activation::Relu));
        let x = x.last_use(|x| self.output.activated(binder, x, Activation::Identity));
        x.last_use(|x| x.scale(OUTPUT_SCALE))
    }
}

/// A linear layer on maps of one pixel: `path.weight` of dimensions (out, in) and `path.bias` (out).
#[derive(Clone, Debug, PartialEq)]
struct Dense {
    path: String,
    inputs: usize,
    outputs: usize,
}

impl Dense {
    fn part(&self, part: &str) -> String {
        format!("{}.{part}", self.path)
    }

    fn declare(&self, blueprint: &mut Blueprint) {
        let init = Init::fan_in(self.inputs);
        blueprint.parameter(self.part("weight"), &[self.outputs, self.inputs], init);
        blueprint.parameter(self.part("bias"), &[self.outputs], init);
    }

    /// (N, in, 1, 1) -> (N, out, 1, 1).
    fn activated<'t, T: Scalar>(&self, binder: &Binder<'t, T>, x: Var<'t, T>, activation: Activation) -> Var<'t, T> {
        let weight = binder.param(&self.part("weight")).reshape(Shape::new(self.outputs, self.inputs, 1, 1));
        let y = x.conv2d_activated(weight, Some(binder.param(&self.part("bias"))), Conv2d::new(1, 0), activation);
        binder.count_macs(y.shape().len() * self.inputs);
        y
    }
}
