//! The pose network, whichever architecture it has.

use std::fmt;
use std::str::FromStr;

use dimode_autodiff::{Scalar, Tape, Tensor, Var};

use crate::kind::{name_of, parse_name};
use crate::{Binder, Blueprint, Network, ParamSet, ResNetPose, ResNetPoseConfig, UnknownName};

/// Pose networks that can be asked for by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PoseNetKind {
    /// `nano`: 395 thousand parameters.
    Nano,
    /// `resnet18`: the size of the reference, 13 million parameters.
    Resnet18,
}

const NAMES: &[(&str, PoseNetKind)] = &[("nano", PoseNetKind::Nano), ("resnet18", PoseNetKind::Resnet18)];

impl PoseNetKind {
    /// The sizes behind the name.
    pub fn config(self) -> PoseNetConfig {
        match self {
            Self::Nano => PoseNetConfig::nano(),
            Self::Resnet18 => PoseNetConfig::resnet18(),
        }
    }
}

impl FromStr for PoseNetKind {
    type Err = UnknownName;
    fn from_str(name: &str) -> Result<Self, UnknownName> {
        parse_name("pose network", name, NAMES)
    }
}

impl fmt::Display for PoseNetKind {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(name_of(*self, NAMES))
    }
}

/// Architecture and sizes of a [`PoseNet`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PoseNetConfig {
    /// ResNet on two stacked images.
    ResNet(ResNetPoseConfig),
}

impl PoseNetConfig {
    /// The smallest one.
    pub fn nano() -> Self {
        Self::ResNet(ResNetPoseConfig::nano())
    }

    /// The size of the reference.
    pub fn resnet18() -> Self {
        Self::ResNet(ResNetPoseConfig::resnet18())
    }
}

/// A relative pose per image pair, scale unknown.
#[derive(Clone, Copy)]
pub struct PosePrediction<'t, T: Scalar> {
    /// Rotation vector in radians, (N, 3, 1, 1).
    pub axis_angle: Var<'t, T>,
    /// Translation, (N, 3, 1, 1).
    pub translation: Var<'t, T>,
}

/// Relative pose from two images.
#[derive(Clone, Debug, PartialEq)]
pub enum PoseNet {
    /// ResNet on two stacked images.
    ResNet(ResNetPose),
}

impl PoseNet {
    /// The network of the given architecture and sizes.
    pub fn new(config: PoseNetConfig) -> Self {
        match config {
            PoseNetConfig::ResNet(config) => Self::ResNet(ResNetPose::new(config)),
        }
    }

    /// Two images in [0, 1], each (N, 3, H, W), **the earlier frame first** -> the pose.
    ///
    /// With the reference convention the output is the transform from the first to the second
    /// camera; for the opposite direction keep the order and invert the transform.
    ///
    /// # Panics
    /// When an image has not three channels or the two differ in size.
    #[track_caller]
    pub fn forward<'t, T: Scalar>(
        &self,
        binder: &mut Binder<'t, T>,
        first: Var<'t, T>,
        second: Var<'t, T>,
    ) -> PosePrediction<'t, T> {
        match self {
            Self::ResNet(net) => {
                let features = net.features(binder, first, second);
                let raw = net.decode(binder, features[4]);
                PosePrediction { axis_angle: raw.slice(1, 0, 3), translation: raw.slice(1, 3, 3) }
            }
        }
    }

    /// Axis-angle and translation without gradients, each (N, 3, 1, 1).
    ///
    /// # Panics
    /// As [`PoseNet::forward`].
    #[track_caller]
    pub fn predict<T: Scalar>(&self, params: &ParamSet<T>, first: &Tensor<T>, second: &Tensor<T>) -> (Tensor<T>, Tensor<T>) {
        let tape = Tape::new();
        let mut binder = Binder::frozen(&tape, params);
        let (first, second) = (tape.constant(first.clone()), tape.constant(second.clone()));
        let pose = self.forward(&mut binder, first, second);
        (pose.axis_angle.value(), pose.translation.value())
    }
}

impl Network for PoseNet {
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
            assert_eq!(name.parse::<PoseNetKind>().unwrap(), kind);
            assert_eq!(kind.to_string(), name);
        }
        assert!("raft".parse::<PoseNetKind>().is_err());
    }

    #[test]
    fn parameter_counts_are_those_of_the_reference() {
        let count = |config| PoseNet::new(config).blueprint().parameter_count();
        assert_eq!(count(PoseNetConfig::nano()), 311_808 + 82_892);
        assert_eq!(count(PoseNetConfig::resnet18()), 11_698_920 + 1_314_572);
    }
}
