//! The unit of the depth decoders: 3x3 convolution over a reflected border, then ELU.

use dimode_autodiff::{Activation, Scalar, Var};

use super::ConvLayer;
use crate::{Binder, Blueprint};

/// Reflection padding by one pixel, 3x3 convolution with bias, ELU with alpha 1.
#[derive(Clone, Debug, PartialEq)]
pub struct ReflectConv {
    conv: ConvLayer,
}

impl ReflectConv {
    /// The unit whose convolution is stored at `path`.
    pub fn new(path: impl Into<String>, inputs: usize, outputs: usize) -> Self {
        Self { conv: ConvLayer::new(path, inputs, outputs, 3).reflect().before_elu() }
    }

    /// The same for [`ReflectConv::linear`]: no ELU follows, and the weights start smaller.
    pub fn head(path: impl Into<String>, inputs: usize, outputs: usize) -> Self {
        Self { conv: ConvLayer::new(path, inputs, outputs, 3).reflect() }
    }

    /// With weights that start uniform in `+-1/sqrt(fan_in)`, smaller than before an ELU else: where several units are added up.
    #[must_use]
    pub fn fan_in(self) -> Self {
        Self { conv: self.conv.fan_in() }
    }

    /// With weights that start normal with the given deviation and a bias that starts at zero.
    #[must_use]
    pub fn normal(self, deviation: f64) -> Self {
        Self { conv: self.conv.normal(deviation) }
    }

    /// Adds weight and bias to the list.
    pub fn declare(&self, blueprint: &mut Blueprint) {
        self.conv.declare(blueprint);
    }

    /// (N, in, H, W) -> (N, out, H, W); height and width at least 2.
    pub fn forward<'t, T: Scalar>(&self, binder: &Binder<'t, T>, x: Var<'t, T>) -> Var<'t, T> {
        self.conv.activated(binder, x, Activation::Elu)
    }

    /// The same without the ELU, for heads.
    pub fn linear<'t, T: Scalar>(&self, binder: &Binder<'t, T>, x: Var<'t, T>) -> Var<'t, T> {
        self.conv.forward(binder, x)
    }
}
