//! The hidden layer that ends both kinds of blocks.

use dimode_autodiff::{Scalar, Var};

use crate::layers::{DropPath, LinearLayer};
use crate::{Binder, Blueprint, Init};

/// What the scales of the branches start at: fresh blocks pass their input on.
pub(super) const SCALE_START: f64 = 1e-6;

/// `skip + drop_path(gamma * pwconv2(GELU(pwconv1(x))))`, pixel by pixel.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Pointwise {
    wide: LinearLayer,
    narrow: LinearLayer,
    gamma: String,
    channels: usize,
    drop: DropPath,
}

impl Pointwise {
    /// The layer of the block stored under `path`.
    pub(super) fn new(path: &str, channels: usize, expansion: usize, drop_rate: f64) -> Self {
        let hidden = channels * expansion;
        Self {
            wide: LinearLayer::new(format!("{path}.pwconv1"), channels, hidden).kaiming(),
            narrow: LinearLayer::new(format!("{path}.pwconv2"), hidden, channels).kaiming(),
            gamma: format!("{path}.gamma"),
            channels,
            drop: DropPath::new(format!("{path}.drop_path"), drop_rate),
        }
    }

    pub(super) fn declare(&self, blueprint: &mut Blueprint) {
        self.wide.declare(blueprint);
        self.narrow.declare(blueprint);
        blueprint.parameter(self.gamma.clone(), &[self.channels], Init::Constant(SCALE_START));
    }

    /// (N, C, H, W) and the skip of the same shape -> the same; gives up the value of `x`.
    pub(super) fn forward<'t, T: Scalar>(&self, binder: &Binder<'t, T>, x: Var<'t, T>, skip: Var<'t, T>) -> Var<'t, T> {
        let gamma = binder.param(&self.gamma);
        let hidden = x.last_use(|x| self.wide.forward(binder, x)).last_use(Var::gelu);
        let y = hidden.last_use(|hidden| self.narrow.scaled(binder, hidden, gamma));
        self.drop.forward(binder, y).last_use(|y| skip.add(y))
    }
}
