//! Any network by role and name, for commands that take all of them.

use std::fmt;
use std::str::FromStr;

use thiserror::Error;

use crate::{Blueprint, DepthNet, DepthNetKind, FlowNet, FlowNetKind, Network, PoseNet, PoseNetKind, UnfitSize};

/// A network of one of the three roles, written `depth:resnet18`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NetKind {
    /// Depth from one image.
    Depth(DepthNetKind),
    /// Motion from two images.
    Pose(PoseNetKind),
    /// Optical flow from two images.
    Flow(FlowNetKind),
}

/// A name that means no network, or more than one.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum UnknownNet {
    /// No network has it.
    #[error("no network is named '{given}'; use one of {}", .known.join(", "))]
    Unknown {
        /// The name.
        given: String,
        /// All that exist, with their roles.
        known: Vec<String>,
    },
    /// Networks of several roles have it.
    #[error("'{given}' names more than one network; write {}", .meant.join(" or "))]
    Ambiguous {
        /// The name.
        given: String,
        /// What it can mean.
        meant: Vec<String>,
    },
}

impl NetKind {
    /// All of them, role by role.
    pub fn all() -> impl Iterator<Item = Self> {
        let depth = DepthNetKind::all().map(Self::Depth);
        depth.chain(PoseNetKind::all().map(Self::Pose)).chain(FlowNetKind::all().map(Self::Flow))
    }

    /// What the network is for: `depth`, `pose` or `flow`.
    pub fn role(self) -> &'static str {
        match self {
            Self::Depth(_) => "depth",
            Self::Pose(_) => "pose",
            Self::Flow(_) => "flow",
        }
    }

    /// The name without the role.
    pub fn name(self) -> String {
        match self {
            Self::Depth(kind) => kind.to_string(),
            Self::Pose(kind) => kind.to_string(),
            Self::Flow(kind) => kind.to_string(),
        }
    }

    /// The tensors of the network.
    pub fn blueprint(self) -> Blueprint {
        match self {
            Self::Depth(kind) => DepthNet::new(kind.config()).blueprint(),
            Self::Pose(kind) => PoseNet::new(kind.config()).blueprint(),
            Self::Flow(kind) => FlowNet::new(kind.config()).blueprint(),
        }
    }

    /// Whether the network takes images of `height` rows and `width` columns.
    ///
    /// # Errors
    /// [`UnfitSize`] when it does not.
    pub fn check_size(self, height: usize, width: usize) -> Result<(), UnfitSize> {
        match self {
            Self::Depth(kind) => DepthNet::new(kind.config()).check_size(height, width),
            Self::Pose(kind) => PoseNet::new(kind.config()).check_size(height, width),
            Self::Flow(kind) => FlowNet::new(kind.config()).check_size(height, width),
        }
    }
}

impl fmt::Display for NetKind {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{}:{}", self.role(), self.name())
    }
}

impl FromStr for NetKind {
    type Err = UnknownNet;

    /// With the role (`pose:resnet18`), or without where one network alone has the name (`raft_small`).
    fn from_str(given: &str) -> Result<Self, UnknownNet> {
        let means = |net: &NetKind| net.to_string() == given || net.name() == given;
        let meant: Vec<NetKind> = Self::all().filter(means).collect();
        let texts = |nets: &[NetKind]| nets.iter().map(NetKind::to_string).collect();
        match meant[..] {
            [net] => Ok(net),
            [] => Err(UnknownNet::Unknown { given: given.to_owned(), known: texts(&Self::all().collect::<Vec<_>>()) }),
            _ => Err(UnknownNet::Ambiguous { given: given.to_owned(), meant: texts(&meant) }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_with_roles_go_both_ways() {
        let all: Vec<NetKind> = NetKind::all().collect();
        for net in &all {
            assert_eq!(net.to_string().parse(), Ok(*net));
        }
        assert_eq!(all.len(), DepthNetKind::all().len() + PoseNetKind::all().len() + FlowNetKind::all().len());
    }

    #[test]
    fn a_bare_name_is_enough_where_it_means_one_network() {
        assert_eq!("raft_small".parse(), Ok(NetKind::Flow(FlowNetKind::RaftSmall)));
        let text = "resnet18".parse::<NetKind>().unwrap_err().to_string();
        assert!(text.ends_with("write depth:resnet18 or pose:resnet18"), "{text}");
        let text = "flow:resnet18".parse::<NetKind>().unwrap_err().to_string();
        assert!(text.starts_with("no network is named 'flow:resnet18'; use one of depth:nano_resnet"), "{text}");
    }

    #[test]
    fn sizes_are_checked_by_the_network() {
        let net = NetKind::Depth(DepthNetKind::Resnet18);
        assert_eq!(net.check_size(192, 640), Ok(()));
        assert!(net.check_size(100, 640).is_err());
        assert!(net.blueprint().parameter_count() > 14_000_000);
    }
}
