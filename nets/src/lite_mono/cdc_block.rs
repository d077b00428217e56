//! Consecutive dilated convolutions: one block, one dilation.

use dimode_autodiff::{Scalar, Var};

use super::pointwise::Pointwise;
use crate::layers::{BatchNorm, ConvLayer, LayerNorm};
use crate::{Binder, Blueprint};

/// `x + drop_path(gamma * pwconv2(GELU(pwconv1(BN(depth-wise conv3x3 with dilation(x))))))`.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct CdcBlock {
    conv: ConvLayer,
    norm: BatchNorm,
    /// In the files of the reference, and never applied there.
    unused: LayerNorm,
    pointwise: Pointwise,
}

impl CdcBlock {
    /// The block stored under `path`.
    pub(super) fn new(path: &str, channels: usize, dilation: usize, expansion: usize, drop_rate: f64) -> Self {
        let conv = ConvLayer::new(format!("{path}.ddwconv.conv"), channels, channels, 3);
        Self {
            conv: conv.depthwise(dilation).without_bias().kaiming(),
            norm: BatchNorm::new(format!("{path}.bn1"), channels),
            unused: LayerNorm::new(format!("{path}.norm"), channels),
            pointwise: Pointwise::new(path, channels, expansion, drop_rate),
        }
    }

    pub(super) fn declare(&self, blueprint: &mut Blueprint) {
        self.conv.declare(blueprint);
        self.norm.declare(blueprint);
        self.unused.declare(blueprint);
        self.pointwise.declare(blueprint);
    }

    /// (N, C, H, W) -> the same.
    pub(super) fn forward<'t, T: Scalar>(&self, binder: &mut Binder<'t, T>, x: Var<'t, T>) -> Var<'t, T> {
        let y = self.conv.forward(binder, x).last_use(|y| self.norm.forward(binder, y));
        self.pointwise.forward(binder, y, x)
    }
}
