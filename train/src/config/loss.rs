//! Terms of the loss that are not geometric, and how many sources and scales they use.

use dimode_geometry::losses::LossOptions;
use serde::{Deserialize, Serialize};

use super::error::{not_negative, require};
use super::{ConfigError, geometric};

/// A term of the local-structure loss.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LocalTerm {
    /// Difference of the surface normals of predicted and pseudo-depth.
    NormalMatching,
}

/// Where the pseudo-depth of the local-structure loss comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PseudoDepth {
    /// No pseudo-depth: the loss is 0.
    None,
    /// The network's own disparity, smoothed with the picture as guide: needs no teacher.
    SelfGuided,
}

/// Settings of the local-structure loss.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LocalStructure {
    /// Terms that are summed.
    pub terms: Vec<LocalTerm>,
    /// Source of the pseudo-depth.
    pub pseudo_depth: PseudoDepth,
}

impl Default for LocalStructure {
    fn default() -> Self {
        Self { terms: vec![LocalTerm::NormalMatching], pseudo_depth: PseudoDepth::None }
    }
}

/// Which neighbours of the target the geometric terms use.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Sources {
    /// Previous and next frame, averaged.
    #[default]
    Both,
    /// The next frame only.
    Next,
}

/// Training of the flow network in stages that train it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FlowLossConfig {
    /// Pairs (target, next) of a batch that it sees in a step.
    pub pairs: usize,
    /// Weight of the second-order smoothness of the flow in pixels.
    pub smoothness: f64,
    /// Its learning rate as a share of the others': it starts from trained weights.
    pub rate: f64,
}

impl Default for FlowLossConfig {
    fn default() -> Self {
        Self { pairs: 2, smoothness: 0.02, rate: 0.1 }
    }
}

/// Mean disparity at which the scale anchor holds a batch.
pub const SCALE_ANCHOR: f64 = 0.2;

/// Terms of the loss. Weights of the geometric and local terms belong to the stages ([`super::StageConfig`]).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LossConfig {
    /// Weight of the edge-aware smoothness of the disparity.
    pub smoothness: f64,
    /// Leave out pixels that the unmoved source already explains better (standing scenes, objects that move along).
    pub auto_mask: bool,
    /// Weight of the plain difference of rigid and optical flow, in pixels. Not a term of the paper: a competitor, off by
    /// default.
    pub flow_consistency: f64,
    /// Weight of the scale anchor, which holds the mean disparity of a batch near [`SCALE_ANCHOR`]. Every other term is blind
    /// to a common scale of depth and translation, so this changes no solution; it keeps the sigmoid from saturating while
    /// the pose network knows nothing yet.
    pub scale_anchor: f64,
    /// Disparity scales in the photometric loss, from the finest.
    pub scales: usize,
    /// Neighbours that the geometric terms use.
    pub sources: Sources,
    /// Local-structure loss.
    pub local_structure: LocalStructure,
    /// Training of the flow network.
    pub flow: FlowLossConfig,
    /// The four geometric losses.
    pub geometric: LossOptions,
}

impl Default for LossConfig {
    fn default() -> Self {
        Self {
            smoothness: 1e-3,
            auto_mask: true,
            flow_consistency: 0.0,
            scale_anchor: 0.1,
            scales: 1,
            sources: Sources::Both,
            local_structure: LocalStructure::default(),
            flow: FlowLossConfig::default(),
            geometric: LossOptions::default(),
        }
    }
}

impl LossConfig {
    /// **Errors** [`ConfigError::Value`] for the first value out of range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        not_negative("loss.smoothness", self.smoothness)?;
        not_negative("loss.flow_consistency", self.flow_consistency)?;
        not_negative("loss.scale_anchor", self.scale_anchor)?;
        require((1..=4).contains(&self.scales), "loss.scales", self.scales, "must be 1 to 4")?;
        not_negative("loss.flow.rate", self.flow.rate)?;
        require((1..=1024).contains(&self.flow.pairs), "loss.flow.pairs", self.flow.pairs, "must be 1 to 1024")?;
        not_negative("loss.flow.smoothness", self.flow.smoothness)?;
        geometric::validate(&self.geometric)
    }
}
