//! Training of the flow network in stages that train it.

use serde::{Deserialize, Serialize};

use super::ConfigError;
use super::error::{not_negative, require};

/// What the flow network's warped image is compared by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FlowData {
    /// Dissimilarity and difference, as in `l_pho`.
    #[default]
    Photometric,
    /// Census of a 3x3 window, as ARFlow.
    CensusArflow,
    /// Census of a 7x7 window, as SMURF.
    CensusSmurf,
    /// Census of a 7x7 window, as UnFlow on its finest level.
    CensusUnflow,
    /// Dissimilarity and difference with occluded pixels painted black, as ARFlow after its first epochs.
    PhotometricArflow,
}

/// Which differences of the flow are penalised.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FlowSmoothnessForm {
    /// Second ones, as ARFlow, which weighs them 75 over the shorter side.
    #[default]
    Second,
    /// Second ones with edges taken across both gaps, as SMURF on KITTI, weight 2.
    SecondWide,
    /// First ones, as SMURF elsewhere, weight 2 to 2.5.
    First,
    /// First ones of the flow's length over its mean, as DF-VO, weight 0.1.
    Length,
}

/// Which of the successive flows are compared.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Iterates {
    /// All, each weighed 0.8 of the next.
    #[default]
    All,
    /// The last.
    Last,
}

/// Which pixels of the target an optical flow can be trusted at.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Occlusion {
    /// Those whose flow ends inside the source.
    #[default]
    InView,
    /// And whose flow back from there ends near them.
    ForwardBackward,
    /// And that enough source pixels flow back to.
    RangeMap,
    /// The same, weighted by how many do.
    SoftRangeMap,
    /// And where following the flow there and back misses least: the matches that DF-VO would take, some 2000 spread over the
    /// image.
    BestMatches,
}

/// Settings of the flow network's own loss.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FlowLossConfig {
    /// Pairs (target, next) of a batch that it sees in a step.
    pub pairs: usize,
    /// How the warped image is compared with the target.
    pub data: FlowData,
    /// Which pixels are compared; all but `in-view` make the network say the flow back, too.
    pub occlusion: Occlusion,
    /// Which flows are compared.
    pub iterates: Iterates,
    /// Weight of it all; at 0 the network learns only from the terms of depth and motion that compare with its flow.
    pub weight: f64,
    /// Weight of the smoothness of the flow in pixels, beside the comparison.
    pub smoothness: f64,
    /// Which differences it takes.
    pub smoothness_form: FlowSmoothnessForm,
    /// Weight of the distance by which the flow back misses the start, pixels; 0 leaves it out.
    pub forward_backward: f64,
    /// Its learning rate as a share of the others': it starts from trained weights.
    pub rate: f64,
}

impl Default for FlowLossConfig {
    fn default() -> Self {
        Self {
            pairs: 2,
            data: FlowData::Photometric,
            occlusion: Occlusion::InView,
            iterates: Iterates::All,
            weight: 1.0,
            smoothness: 0.02,
            smoothness_form: FlowSmoothnessForm::Second,
            forward_backward: 0.0,
            rate: 0.1,
        }
    }
}

impl FlowLossConfig {
    /// **Errors** [`ConfigError::Value`] for the first value out of range.
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        not_negative("loss.flow.rate", self.rate)?;
        require((1..=1024).contains(&self.pairs), "loss.flow.pairs", self.pairs, "must be 1 to 1024")?;
        let advice = "a choice of matches is no choice of what is seen; use in-view, forward-backward or range-map";
        require(self.occlusion != Occlusion::BestMatches, "loss.flow.occlusion", "best-matches", advice)?;
        not_negative("loss.flow.smoothness", self.smoothness)?;
        not_negative("loss.flow.weight", self.weight)?;
        not_negative("loss.flow.forward_backward", self.forward_backward)
    }
}
