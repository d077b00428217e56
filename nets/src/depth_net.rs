//! The depth network, whichever architecture it has.

use std::fmt;
use std::str::FromStr;

use dimode_autodiff::{Scalar, Tape, Tensor, Var};

use crate::kind::{name_of, parse_name};
use crate::{Binder, Blueprint, Network, ParamSet, ResNetDepth, ResNetDepthConfig, UnknownName};

/// Depth networks that can be asked for by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DepthNetKind {
    /// `nano_resnet`: 134 thousand parameters.
    NanoResnet,
    /// `resnet18`: the size of the reference, 14.8 million parameters.
    Resnet18,
}

const NAMES: &[(&str, DepthNetKind)] = &[("nano_resnet", DepthNetKind::NanoResnet), ("resnet18", DepthNetKind::Resnet18)];

impl DepthNetKind {
    /// The sizes behind the name.
    pub fn config(self) -> DepthNetConfig {
        match self {
            Self::NanoResnet => DepthNetConfig::nano(),
            Self::Resnet18 => DepthNetConfig::resnet18(),
        }
    }
}

impl FromStr for DepthNetKind {
    type Err = UnknownName;
    fn from_str(name: &str) -> Result<Self, UnknownName> {
        parse_name("depth network", name, NAMES)
    }
}

impl fmt::Display for DepthNetKind {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(name_of(*self, NAMES))
    }
}

/// Architecture and sizes of a [`DepthNet`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum DepthNetConfig {
    /// ResNet encoder with a skip-connection decoder.
    ResNet(ResNetDepthConfig),
}

impl DepthNetConfig {
    /// The smallest one.
    pub fn nano() -> Self {
        Self::ResNet(ResNetDepthConfig::nano())
    }

    /// The baseline of the field.
    pub fn resnet18() -> Self {
        Self::ResNet(ResNetDepthConfig::resnet18())
    }
}

/// Disparity from one image.
#[derive(Clone, Debug, PartialEq)]
pub enum DepthNet {
    /// ResNet encoder with a skip-connection decoder.
    ResNet(ResNetDepth),
}

impl DepthNet {
    /// The network of the given architecture and sizes.
    pub fn new(config: DepthNetConfig) -> Self {
        match config {
            DepthNetConfig::ResNet(config) => Self::ResNet(ResNetDepth::new(config)),
        }
    }

    /// Images in [0, 1], (N, 3, H, W) -> disparities in (0, 1), (N, 1, H / 2^s, W / 2^s), full
    /// size first.
    ///
    /// # Panics
    /// When height or width is not a multiple of 32 or is below 64.
    #[track_caller]
    pub fn forward<'t, T: Scalar>(&self, binder: &mut Binder<'t, T>, images: Var<'t, T>) -> Vec<Var<'t, T>> {
        match self {
            Self::ResNet(net) => {
                let features = net.features(binder, images);
                net.decode(binder, &features)
            }
        }
    }

    /// The full-size disparity alone, without gradients: (N, 3, H, W) -> (N, 1, H, W).
    ///
    /// # Panics
    /// As [`DepthNet::forward`].
    #[track_caller]
    pub fn predict<T: Scalar>(&self, params: &ParamSet<T>, images: &Tensor<T>) -> Tensor<T> {
        let tape = Tape::new();
        let mut binder = Binder::frozen(&tape, params);
        let images = tape.constant(images.clone());
        self.forward(&mut binder, images)[0].value()
    }
}

impl Network for DepthNet {
    fn blueprint(&self) -> Blueprint {
        match self {
            Self::ResNet(net) => net.blueprint(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_go_both_ways() {
        for &(name, kind) in NAMES {
            assert_eq!(name.parse::<DepthNetKind>().unwrap(), kind);
            assert_eq!(kind.to_string(), name);
        }
        let text = "resnet".parse::<DepthNetKind>().unwrap_err().to_string();
        assert!(text.contains("'resnet'") && text.contains("nano_resnet"));
    }

    #[test]
    fn parameter_counts_are_those_of_the_reference() {
        let count = |config| DepthNet::new(config).blueprint().parameter_count();
        assert_eq!(count(DepthNetConfig::nano()), 78_312 + 55_892);
        assert_eq!(count(DepthNetConfig::resnet18()), 11_689_512 + 3_152_724);
    }
}
