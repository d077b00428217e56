//! Terms of the loss, and how many sources and scales they use.

use dimode_geometry::losses::LossOptions;
use serde::{Deserialize, Serialize};

use super::error::{not_negative, require};
use super::{ConfigError, FlowLossConfig, LocalStructure, LossPreset, Occlusion, geometric};

/// How views are compared by their colours: the form of `l_pho`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Photometric {
    /// The smallest error over both sources, as Monodepth2 and the paper.
    #[default]
    MinimumReprojection,
    /// The best of both sources and both directions, weighted by the agreement of the depths, as sc_depth_pl.
    ScDepth,
    /// All pairs and directions added up, weighted by the agreement of the depths, as SC-SfMLearner-Release.
    ScSfm,
}

/// What the smoothness is measured on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SmoothnessOf {
    /// The disparity over its mean.
    #[default]
    Disparity,
    /// The depth over its mean, as the SC-Depth programs.
    Depth,
}

/// Which neighbours of the target the terms with optical flow use.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Sources {
    /// Previous and next frame, averaged.
    #[default]
    Both,
    /// The next frame only.
    Next,
}

/// Which depth flow and motion imply in DCPI-Depth's contextual-geometric consistency.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ContextualDepth {
    /// By the radial part of the flow, the version of all published commands.
    #[default]
    Radial,
    /// Triangulated from the sum of both image equations.
    Triangulated,
}

/// Mean disparity at which the scale anchor holds a batch.
pub const SCALE_ANCHOR: f64 = 0.2;

/// Terms of the loss with the weights that do not change over a run; those that do belong to the stages ([`super::StageConfig`]).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LossConfig {
    /// The method that the loss and the stages start from; what the file names beside it changes single values.
    pub preset: LossPreset,
    /// Form of the photometric loss.
    pub photometric: Photometric,
    /// Its weight.
    pub photometric_weight: f64,
    /// Take the mean over the sources instead of the smallest error, in `minimum-reprojection`.
    pub average_sources: bool,
    /// Leave out pixels that the unmoved source already explains better (standing scenes, objects that move along). The other
    /// forms than `minimum-reprojection` always do.
    pub auto_mask: bool,
    /// Disparity scales in `minimum-reprojection`, smoothness and cross-task consistency, from the finest.
    pub scales: usize,
    /// Weight of the edge-aware smoothness.
    pub smoothness: f64,
    /// What it is measured on.
    pub smoothness_of: SmoothnessOf,
    /// Weight of the relative difference of the depths that two views see, SC-Depth's geometry consistency.
    pub geometry_consistency: f64,
    /// Weight of the known rotation that the network of `nets.rectify` misses.
    pub rotation_consistency: f64,
    /// Weight of the rotation that it leaves, beyond what it found.
    pub rotation_triplet: f64,
    /// Weight of the plain difference of rigid and optical flow, in pixels. Not a term of the paper: a competitor, off by
    /// default.
    pub flow_consistency: f64,
    /// Weight of the scale anchor, which holds the mean disparity of a batch near [`SCALE_ANCHOR`]. All terms but ranking and
    /// `below_ground` are blind to a common scale of depth and translation, so this changes no solution of theirs; it keeps the
    /// sigmoid from saturating while the pose network knows nothing yet.
    pub scale_anchor: f64,
    /// Weight of Dynamo-Depth's penalty on points below the ground, which is found in the lower part of the depth itself; 0.1
    /// there.
    pub below_ground: f64,
    /// Neighbours that the geometric and contextual terms use.
    pub sources: Sources,
    /// Where the optical flow is trusted in flow consistency and in the geometric terms, beside the static mask.
    pub occlusion: Occlusion,
    /// The depth that `contextual` of a stage compares with.
    pub contextual_depth: ContextualDepth,
    /// Local-structure loss.
    pub local_structure: LocalStructure,
    /// Training of the flow network.
    pub flow: FlowLossConfig,
    /// The four geometric losses.
    pub geometric: LossOptions,
}

impl Default for LossConfig {
    fn default() -> Self {
        LossPreset::default().loss()
    }
}

impl LossConfig {
    /// What the presets have in common.
    pub(super) fn plain() -> Self {
        Self {
            preset: LossPreset::Dimode,
            photometric: Photometric::MinimumReprojection,
            photometric_weight: 1.0,
            average_sources: false,
            auto_mask: true,
            scales: 1,
            smoothness: 1e-3,
            smoothness_of: SmoothnessOf::Disparity,
            geometry_consistency: 0.0,
            rotation_consistency: 1.0,
            rotation_triplet: 1.0,
            flow_consistency: 0.0,
            scale_anchor: 0.1,
            below_ground: 0.0,
            sources: Sources::Both,
            occlusion: Occlusion::InView,
            contextual_depth: ContextualDepth::Radial,
            local_structure: LocalStructure::default(),
            flow: FlowLossConfig::default(),
            geometric: LossOptions::default(),
        }
    }

    /// **Errors** [`ConfigError::Value`] for the first value out of range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        not_negative("loss.photometric_weight", self.photometric_weight)?;
        not_negative("loss.smoothness", self.smoothness)?;
        not_negative("loss.geometry_consistency", self.geometry_consistency)?;
        not_negative("loss.rotation_consistency", self.rotation_consistency)?;
        not_negative("loss.rotation_triplet", self.rotation_triplet)?;
        not_negative("loss.flow_consistency", self.flow_consistency)?;
        not_negative("loss.scale_anchor", self.scale_anchor)?;
        not_negative("loss.below_ground", self.below_ground)?;
        require((1..=4).contains(&self.scales), "loss.scales", self.scales, "must be 1 to 4")?;
        self.local_structure.validate()?;
        self.flow.validate()?;
        geometric::validate(&self.geometric)
    }
}
