//! Layer normalisation over the channels of every pixel.

use dimode_autodiff::{Scalar, Var};

use crate::{Binder, Blueprint, Init};

/// Added to the variance before the square root.
const EPSILON: f64 = 1e-6;

/// Layer normalisation over channels: `path.weight` and `path.bias`, both of dimension (channels).
#[derive(Clone, Debug, PartialEq)]
pub struct LayerNorm {
    path: String,
    channels: usize,
}

impl LayerNorm {
    /// The layer stored at `path`.
    pub fn new(path: impl Into<String>, channels: usize) -> Self {
        Self { path: path.into(), channels }
    }

    fn part(&self, part: &str) -> String {
        format!("{}.{part}", self.path)
    }

    /// Adds scale and offset to the list.
    pub fn declare(&self, blueprint: &mut Blueprint) {
        blueprint.parameter(self.part("weight"), &[self.channels], Init::Constant(1.0));
        blueprint.parameter(self.part("bias"), &[self.channels], Init::Constant(0.0));
    }

    /// (N, C, H, W) -> the same.
    pub fn forward<'t, T: Scalar>(&self, binder: &Binder<'t, T>, x: Var<'t, T>) -> Var<'t, T> {
        x.layer_norm(binder.param(&self.part("weight")), binder.param(&self.part("bias")), EPSILON)
    }
}
