//! Which networks are trained and where their first weights come from.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use dimode_nets::{DepthNetKind, FlowNetKind, PoseNetKind, RectifyNetConfig};
use serde::{Deserialize, Serialize};

use super::error::{positive, require};
use super::{ConfigError, by_name};

/// Where the first weights of a pre-trained network come from.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum FirstWeights {
    /// What is part of the program: made by `dimode pretrain`.
    #[default]
    Embedded,
    /// Random numbers from the seed.
    Random,
    /// A folder with the network's files, or the file of a network that has one only: what `dimode pretrain` or
    /// `dimode weights convert` wrote, or the checkpoints of the reference.
    File(PathBuf),
}

impl fmt::Display for FirstWeights {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Embedded => f.write_str("embedded"),
            Self::Random => f.write_str("random"),
            Self::File(path) => write!(f, "{}", path.display()),
        }
    }
}

impl FromStr for FirstWeights {
    type Err = std::convert::Infallible;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        Ok(match name {
            "embedded" => Self::Embedded,
            "random" => Self::Random,
            path => Self::File(PathBuf::from(path)),
        })
    }
}

/// The network that removes the rotation between two frames before depth and pose look, as SC-Depth V2 does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Rectify {
    /// There is none.
    #[default]
    None,
    /// 394 thousand parameters.
    Nano,
    /// The size of the reference, 13 million parameters.
    Resnet18,
}

impl Rectify {
    /// What configuration files call it.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Nano => "nano",
            Self::Resnet18 => "resnet18",
        }
    }

    /// The sizes behind the name.
    pub fn config(self) -> Option<RectifyNetConfig> {
        match self {
            Self::None => None,
            Self::Nano => Some(RectifyNetConfig::nano()),
            Self::Resnet18 => Some(RectifyNetConfig::resnet18()),
        }
    }
}

/// The networks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NetsConfig {
    /// Depth network: `nano_resnet`, `nano_lite_mono`, `nano_d_hrnet`, `resnet18`, `lite_mono`, `lite_mono_tiny`,
    /// `lite_mono_small`, `lite_mono_8m` or `d_hrnet`.
    #[serde(with = "by_name")]
    pub depth: DepthNetKind,
    /// Pose network: `nano`, `nano_scipad`, `resnet18` or `scipad`.
    #[serde(with = "by_name")]
    pub pose: PoseNetKind,
    /// Flow network: `nano_raft`, `nano_raft_d4`, `raft_small` or `raft_full`.
    #[serde(with = "by_name")]
    pub flow: FlowNetKind,
    /// Network that removes rotation first: `none`, `nano` or `resnet18`. It is trained with the pose network and goes with losses
    /// without optical flow only.
    pub rectify: Rectify,
    /// First weights of the depth network: `random`, or a folder with its files, as `encoder.safetensors` and
    /// `depth.safetensors`. A file that is not there leaves its part random: an encoder that knows other pictures, for
    /// instance, and a decoder that knows nothing yet.
    #[serde(with = "by_name")]
    pub depth_weights: FirstWeights,
    /// First weights of the flow network: `embedded`, `random` or a file.
    #[serde(with = "by_name")]
    pub flow_weights: FirstWeights,
    /// First weights of the pose network: `embedded`, `random` or a folder with `pose_encoder.safetensors` and
    /// `pose.safetensors`, or with `posenet.safetensors` for SCIPaD. They belong to the default factors and depth range below;
    /// with others the motions that they say at first have another size.
    #[serde(with = "by_name")]
    pub pose_weights: FirstWeights,
    /// Factor on the rotation vector that the pose network says. The reference head says hundredths of a radian, for
    /// networks that train for days; 1 is the reference.
    pub rotation_scale: f64,
    /// Factor on the tangential translation (x, y) that the pose network says; 1 is the reference. Small beside
    /// `rotation_scale`: while depth is still flat, yaw and sideways motion look alike, and the larger step wins.
    pub tangential_scale: f64,
    /// Factor on the radial translation (z) that the pose network says; 1 is the reference. Large: depth learns from radial
    /// flow only once z is of the right size.
    pub radial_scale: f64,
    /// Looks of the pose network at a pair in training. From the second on it sees the source warped by the depth and the motion
    /// said so far, and says what is left; 1 is the reference.
    pub pose_iterations: usize,
    /// Looks where motion is predicted; 1 is the reference.
    pub pose_test_iterations: usize,
    /// Refinements of the flow per pair.
    pub flow_iterations: usize,
    /// Smallest depth the depth network can say, in the free unit of monocular training. Half the disparity range is twice
    /// this depth; a unit near 1 keeps rotation and translation equally easy to learn (docs/training.md).
    pub min_depth: f64,
    /// Largest depth the depth network can say.
    pub max_depth: f64,
}

impl Default for NetsConfig {
    fn default() -> Self {
        Self {
            depth: DepthNetKind::NanoResnet,
            pose: PoseNetKind::Nano,
            flow: FlowNetKind::NanoRaftD4,
            rectify: Rectify::None,
            depth_weights: FirstWeights::Random,
            flow_weights: FirstWeights::Embedded,
            pose_weights: FirstWeights::Embedded,
            pose_iterations: 2,
            pose_test_iterations: 4,
            flow_iterations: 4,
            rotation_scale: 10.0,
            tangential_scale: 3.0,
            radial_scale: 10.0,
            min_depth: 0.1,
            max_depth: 100.0,
        }
    }
}

impl NetsConfig {
    /// **Errors** [`ConfigError::Value`] for the first value out of range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let iterations = self.flow_iterations;
        require((1..=64).contains(&iterations), "nets.flow_iterations", iterations, "must be 1 to 64")?;
        for (key, looks) in
            [("nets.pose_iterations", self.pose_iterations), ("nets.pose_test_iterations", self.pose_test_iterations)]
        {
            require((1..=16).contains(&looks), key, looks, "must be 1 to 16")?;
        }
        let advice = "none are part of the program; use \"random\", or a folder of weights";
        require(self.depth_weights != FirstWeights::Embedded, "nets.depth_weights", &self.depth_weights, advice)?;
        let embedded = self.flow_weights == FirstWeights::Embedded && self.flow != FlowNetKind::NanoRaftD4;
        let advice = "only those of nano_raft_d4 are part of the program; use \"random\", or a file of weights";
        require(!embedded, "nets.flow_weights", &self.flow_weights, advice)?;
        let embedded = self.pose_weights == FirstWeights::Embedded && self.pose != PoseNetKind::Nano;
        let advice = "only those of nano are part of the program; use \"random\", or a folder of weights";
        require(!embedded, "nets.pose_weights", &self.pose_weights, advice)?;
        positive("nets.rotation_scale", self.rotation_scale)?;
        positive("nets.tangential_scale", self.tangential_scale)?;
        positive("nets.radial_scale", self.radial_scale)?;
        positive("nets.min_depth", self.min_depth)?;
        positive("nets.max_depth", self.max_depth)?;
        require(self.max_depth > self.min_depth, "nets.max_depth", self.max_depth, "must be above nets.min_depth")
    }
}
