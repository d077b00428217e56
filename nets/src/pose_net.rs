//! The pose network, whichever architecture it has.

use std::fmt;
use std::str::FromStr;

use dimode_autodiff::{Scalar, Tape, Tensor, Var};

use crate::kind::{name_of, parse_name};
use crate::{
    Binder, Blueprint, Network, ParamSet, ResNetPose, ResNetPoseConfig, ScipadConfig, ScipadPose, UnfitSize, UnknownName,
};

/// Pose networks that can be asked for by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PoseNetKind {
    /// `nano`: 395 thousand parameters.
    Nano,
    /// `resnet18`: the size of the reference, 13 million parameters.
    Resnet18,
    /// `nano_scipad`: 149 thousand parameters, its frozen encoder random: for tests of the code.
    NanoScipad,
    /// `scipad`: SCIPaD at the size of the reference, 36.5 million parameters.
    Scipad,
}

const NAMES: &[(&str, PoseNetKind)] = &[
    ("nano", PoseNetKind::Nano),
    ("resnet18", PoseNetKind::Resnet18),
    ("nano_scipad", PoseNetKind::NanoScipad),
    ("scipad", PoseNetKind::Scipad),
];

impl PoseNetKind {
    /// All of them, in the order in which messages list their names.
    pub fn all() -> impl ExactSizeIterator<Item = Self> {
        NAMES.iter().map(|&(_, kind)| kind)
    }

    /// The sizes behind the name.
    pub fn config(self) -> PoseNetConfig {
        match self {
            Self::Nano => PoseNetConfig::nano(),
            Self::Resnet18 => PoseNetConfig::resnet18(),
            Self::NanoScipad => PoseNetConfig::nano_scipad(),
            Self::Scipad => PoseNetConfig::scipad(),
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
    /// Semantic features and the flow of frozen ones.
    Scipad(ScipadConfig),
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

    /// SCIPaD, small, for tests of the code.
    pub fn nano_scipad() -> Self {
        Self::Scipad(ScipadConfig::nano())
    }

    /// SCIPaD at the size of the reference.
    pub fn scipad() -> Self {
        Self::Scipad(ScipadConfig::scipad())
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
    ResNet(Box<ResNetPose>),
    /// Semantic features and the flow of frozen ones.
    Scipad(Box<ScipadPose>),
}

impl PoseNet {
    /// The network of the given architecture and sizes.
    pub fn new(config: PoseNetConfig) -> Self {
        match config {
            PoseNetConfig::ResNet(config) => Self::ResNet(Box::new(ResNetPose::new(config))),
            PoseNetConfig::Scipad(config) => Self::Scipad(Box::new(ScipadPose::new(config))),
        }
    }

    /// Whether images of `height` rows and `width` columns fit.
    ///
    /// # Errors
    /// [`UnfitSize`] when they do not.
    pub fn check_size(&self, height: usize, width: usize) -> Result<(), UnfitSize> {
        match self {
            Self::ResNet(net) => net.check_size(height, width),
            Self::Scipad(net) => net.check_size(height, width),
        }
    }

    /// Two images in [0, 1], each (N, 3, H, W), **the earlier frame first** -> the pose.
    ///
    /// With the reference convention the output is the transform from the first to the second
    /// camera; for the opposite direction keep the order and invert the transform.
    ///
    /// SCIPaD calls the first image target and the second one reference; its point cloud is zero here, as it was in all
    /// likelihood when the published weights were trained.
    ///
    /// # Panics
    /// When an image has not three channels, the two differ in size or do not fit ([`PoseNet::check_size`]).
    #[track_caller]
    pub fn forward<'t, T: Scalar>(
        &self,
        binder: &mut Binder<'t, T>,
        first: Var<'t, T>,
        second: Var<'t, T>,
    ) -> PosePrediction<'t, T> {
        self.forward_with_points(binder, first, second, None)
    }

    /// The same with the point of every pixel of the first image in its camera's frame, (N, 3, H, W), for the networks that look
    /// at points: SCIPaD. The others do not notice.
    ///
    /// # Panics
    /// As [`PoseNet::forward`], and when SCIPaD is given other than three coordinates for each sample.
    #[track_caller]
    pub fn forward_with_points<'t, T: Scalar>(
        &self,
        binder: &mut Binder<'t, T>,
        first: Var<'t, T>,
        second: Var<'t, T>,
        points: Option<Var<'t, T>>,
    ) -> PosePrediction<'t, T> {
        let raw = match self {
            Self::ResNet(net) => {
                let features = net.features(binder, first, second);
                net.decode(binder, features[4])
            }
            Self::Scipad(net) => net.trace(binder, first, second, points).pose,
        };
        PosePrediction { axis_angle: raw.slice(1, 0, 3), translation: raw.slice(1, 3, 3) }
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
            Self::Scipad(net) => net.blueprint(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Kind;

    #[test]
    fn names_go_both_ways() {
        for &(name, kind) in NAMES {
            assert!(PoseNetKind::all().any(|listed| listed == kind));
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
        assert_eq!(count(PoseNetConfig::nano_scipad()), 148_986);
        assert_eq!(count(PoseNetConfig::scipad()), 36_504_106);
    }

    #[test]
    fn the_frozen_part_of_scipad_is_that_of_the_reference() {
        let blueprint = PoseNet::new(PoseNetConfig::scipad()).blueprint();
        let count = |prefix: &str, kind| {
            let of = blueprint.declarations().iter().filter(|d| d.path.starts_with(prefix) && d.kind == kind);
            of.map(|d| d.dims.iter().product::<usize>()).sum::<usize>()
        };
        assert_eq!(count("posenet:frozen_feature_extractor.", Kind::Frozen), 23_508_032);
        assert_eq!(count("posenet:frozen_feature_extractor.", Kind::Parameter), 0);
        assert_eq!(count("posenet:", Kind::Frozen), 23_508_032);
        assert_eq!(count("posenet:sem_feature_extractor.", Kind::Parameter), 11_185_920);
        assert_eq!(count("posenet:pca.", Kind::Parameter), 19_680);
        assert_eq!(count("posenet:hpei.", Kind::Parameter), 1_642_308);
        assert_eq!(count("posenet:decoder.", Kind::Parameter), 148_166);
    }
}
