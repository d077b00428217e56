//! Sizes of the flow network.

use std::fmt;
use std::str::FromStr;

use crate::UnknownName;
use crate::kind::{name_of, parse_name};
use crate::layers::{Norm, TrainingStatistics};

/// Flow networks that can be asked for by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FlowNetKind {
    /// `nano_raft`: 152 thousand parameters, flow at 1/8 of the size.
    NanoRaft,
    /// `nano_raft_d4`: the same tensors, flow at 1/4 of the size.
    NanoRaftD4,
    /// `raft_small`: the small reference, 990 thousand parameters.
    RaftSmall,
    /// `raft_full`: the full reference, 5.26 million parameters.
    RaftFull,
}

const NAMES: &[(&str, FlowNetKind)] = &[
    ("nano_raft", FlowNetKind::NanoRaft),
    ("nano_raft_d4", FlowNetKind::NanoRaftD4),
    ("raft_small", FlowNetKind::RaftSmall),
    ("raft_full", FlowNetKind::RaftFull),
];

impl FlowNetKind {
    /// All of them, in the order in which messages list their names.
    pub fn all() -> impl ExactSizeIterator<Item = Self> {
        NAMES.iter().map(|&(_, kind)| kind)
    }

    /// The sizes behind the name.
    pub fn config(self) -> FlowNetConfig {
        match self {
            Self::NanoRaft => FlowNetConfig::nano_raft(),
            Self::NanoRaftD4 => FlowNetConfig::nano_raft_d4(),
            Self::RaftSmall => FlowNetConfig::raft_small(),
            Self::RaftFull => FlowNetConfig::raft_full(),
        }
    }
}

impl FromStr for FlowNetKind {
    type Err = UnknownName;
    fn from_str(name: &str) -> Result<Self, UnknownName> {
        parse_name("flow network", name, NAMES)
    }
}

impl fmt::Display for FlowNetKind {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(name_of(*self, NAMES))
    }
}

/// Which parts a [`crate::FlowNet`] is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RaftVariant {
    /// Bottlenecks, no norm in the context encoder, a recurrent unit of 3x3 convolutions, bilinear upsampling.
    Small,
    /// Residual blocks, batch norm in the context encoder, a recurrent unit of a 1x5 and a 5x1 pass, convex upsampling.
    Full(RaftFull),
}

/// What the full variant has and the small one has not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RaftFull {
    /// First layer, 1x1, of the correlation branch of the motion encoder; the second one is 3x3.
    pub lookup: usize,
    /// Hidden layer of the mask head, which says how to upsample.
    pub mask: usize,
    /// What the batch norms of the context encoder do in training. The reference trains them on FlyingChairs only.
    pub statistics: TrainingStatistics,
}

/// Sizes of a [`crate::FlowNet`]; all counts are channels unless said otherwise.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FlowNetConfig {
    /// Kind of the blocks, the recurrent unit and the upsampling.
    pub variant: RaftVariant,
    /// Stem of both encoders, at half the size.
    pub stem: usize,
    /// The three stages of both encoders; each a multiple of four in the small variant.
    pub stages: [usize; 3],
    /// Stride of the third stage: 2 for flow at 1/8, 1 for flow at 1/4 of the size.
    pub last_stride: usize,
    /// Features that are correlated.
    pub features: usize,
    /// Hidden state of the recurrent unit.
    pub hidden: usize,
    /// Context features.
    pub context: usize,
    /// Levels of the correlation pyramid.
    pub levels: usize,
    /// Look-up radius in cells of each level.
    pub radius: usize,
    /// Correlation branch of the motion encoder, at its end.
    pub correlation: usize,
    /// Flow branch of the motion encoder: 7x7, then 3x3 convolution.
    pub flow: [usize; 2],
    /// Motion features, without the two of the flow itself.
    pub motion: usize,
    /// Hidden layer of the flow head.
    pub head: usize,
    /// Refinement steps when none are asked for.
    pub iterations: usize,
}

impl FlowNetConfig {
    /// The nano size, flow at 1/8 of the image size.
    pub fn nano_raft() -> Self {
        Self {
            variant: RaftVariant::Small,
            stem: 16,
            stages: [16, 24, 32],
            last_stride: 2,
            features: 48,
            hidden: 32,
            context: 32,
            levels: 3,
            radius: 3,
            correlation: 48,
            flow: [32, 16],
            motion: 32,
            head: 48,
            iterations: 4,
        }
    }

    /// The nano size, flow at 1/4 of the image size: the better one for images of 64 rows.
    pub fn nano_raft_d4() -> Self {
        Self { last_stride: 1, ..Self::nano_raft() }
    }

    /// The small reference network.
    pub fn raft_small() -> Self {
        Self {
            variant: RaftVariant::Small,
            stem: 32,
            stages: [32, 64, 96],
            last_stride: 2,
            features: 128,
            hidden: 96,
            context: 64,
            levels: 4,
            radius: 3,
            correlation: 96,
            flow: [64, 32],
            motion: 80,
            head: 128,
            iterations: 12,
        }
    }

    /// The full reference network, its batch norms frozen.
    pub fn raft_full() -> Self {
        Self {
            variant: RaftVariant::Full(RaftFull { lookup: 256, mask: 256, statistics: TrainingStatistics::Running }),
            stem: 64,
            stages: [64, 96, 128],
            last_stride: 2,
            features: 256,
            hidden: 128,
            context: 128,
            levels: 4,
            radius: 4,
            correlation: 192,
            flow: [128, 64],
            motion: 126,
            head: 256,
            iterations: 12,
        }
    }

    /// The same sizes for the first training from random weights, in which batch norms learn their statistics: the
    /// FlyingChairs stage of the reference.
    #[must_use]
    pub fn learning_statistics(mut self) -> Self {
        if let RaftVariant::Full(full) = &mut self.variant {
            full.statistics = TrainingStatistics::Batch;
        }
        self
    }

    /// The norm of the context encoder.
    pub(super) fn context_norm(&self) -> Norm {
        match self.variant {
            RaftVariant::Small => Norm::None,
            RaftVariant::Full(full) => Norm::Batch(full.statistics),
        }
    }

    /// Image size divided by flow size inside the network.
    pub fn factor(&self) -> usize {
        4 * self.last_stride
    }

    /// Channels of one look-up: a square window at each level.
    pub fn lookup_channels(&self) -> usize {
        let side = 2 * self.radius + 1;
        self.levels * side * side
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{FlowNet, Network};

    #[test]
    fn names_go_both_ways() {
        for &(name, kind) in NAMES {
            assert!(FlowNetKind::all().any(|listed| listed == kind));
            assert_eq!(name.parse::<FlowNetKind>().unwrap(), kind);
            assert_eq!(kind.to_string(), name);
        }
        assert!("raft".parse::<FlowNetKind>().is_err());
    }

    #[test]
    fn parameter_counts_are_those_of_the_reference() {
        let count = |kind: FlowNetKind| {
            let blueprint = FlowNet::new(kind.config()).blueprint();
            blueprint.parameter_count()
        };
        assert_eq!(count(FlowNetKind::NanoRaft), 151_810);
        assert_eq!(count(FlowNetKind::NanoRaftD4), 151_810);
        assert_eq!(count(FlowNetKind::RaftSmall), 990_162);
        assert_eq!(count(FlowNetKind::RaftFull), 5_257_536);
    }
}
