//! What the terms of a stage ask of the networks beside the targets' disparities and the motions.

use crate::config::Occlusion;

/// Depth of the source frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum SourceDepth {
    /// Not needed.
    #[default]
    None,
    /// Its values.
    Value,
    /// Values that pass a gradient.
    Gradient,
}

/// Optical flow.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum FlowWays {
    /// Not needed.
    #[default]
    None,
    /// From target to source.
    Forward,
    /// And back.
    Both,
}

impl FlowWays {
    /// Those that tell where the flow is trusted.
    pub(super) fn to_trust(occlusion: Occlusion) -> Self {
        if occlusion == Occlusion::InView { Self::Forward } else { Self::Both }
    }
}

/// What a term, or a stage, needs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Needs {
    /// Depth of the sources.
    pub source_depth: SourceDepth,
    /// Optical flow between target and sources.
    pub flow: FlowWays,
}

impl Needs {
    /// What both need.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        Needs { source_depth: self.source_depth.max(other.source_depth), flow: self.flow.max(other.flow) }
    }
}
