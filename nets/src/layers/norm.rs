//! The normalisation after a convolution, where an architecture leaves the choice.

use dimode_autodiff::{Activation, Scalar, Var};

use super::{BatchNorm, TrainingStatistics};
use crate::{Binder, Blueprint};

/// Added to the variance of instance normalisation.
const EPSILON: f64 = 1e-5;

/// Which normalisation follows a convolution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Norm {
    /// None.
    None,
    /// Per image and channel over height and width, without parameters, the same in training and evaluation.
    Instance,
    /// Per channel over the batch, with parameters and running statistics.
    Batch(TrainingStatistics),
}

/// A [`Norm`] at its place in a network.
#[derive(Clone, Debug, PartialEq)]
pub enum NormLayer {
    /// None.
    None,
    /// Instance normalisation, which stores nothing.
    Instance,
    /// Batch normalisation.
    Batch(BatchNorm),
}

impl Norm {
    /// The layer that would store its tensors at `path`.
    pub fn layer(self, path: String, channels: usize) -> NormLayer {
        match self {
            Self::None => NormLayer::None,
            Self::Instance => NormLayer::Instance,
            Self::Batch(statistics) => NormLayer::Batch(BatchNorm::new(path, channels).statistics(statistics)),
        }
    }
}

impl NormLayer {
    /// Adds what the layer stores to the list.
    pub fn declare(&self, blueprint: &mut Blueprint) {
        if let Self::Batch(norm) = self {
            norm.declare(blueprint);
        }
    }

    /// (N, C, H, W) -> the same; gives up the value of `x`.
    pub fn forward<'t, T: Scalar>(&self, binder: &mut Binder<'t, T>, x: Var<'t, T>) -> Var<'t, T> {
        match self {
            Self::None => x,
            Self::Instance => x.last_use(|x| x.instance_norm(EPSILON)),
            Self::Batch(norm) => x.last_use(|x| norm.forward(binder, x)),
        }
    }

    /// The same, and the ReLU of the result.
    pub fn relu<'t, T: Scalar>(&self, binder: &mut Binder<'t, T>, x: Var<'t, T>) -> Var<'t, T> {
        match self {
            Self::None | Self::Instance => self.forward(binder, x).last_use(Var::relu),
            Self::Batch(norm) => x.last_use(|x| norm.activated(binder, x, None, Activation::Relu)),
        }
    }
}
