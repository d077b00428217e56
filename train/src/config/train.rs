//! Steps, optimiser and stages.

use serde::{Deserialize, Serialize};

use super::error::{fraction, not_negative, positive, require};
use super::{ConfigError, LossPreset};

/// How the learning rate falls after the warm-up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Decay {
    /// It does not.
    Constant,
    /// Half a cosine, down to `final_fraction` of the full rate at the last step.
    #[default]
    Cosine,
}

/// One stage: a share of the steps with its weights and trained networks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StageConfig {
    /// Name in logs and reports.
    pub name: String,
    /// Share of all steps; shares are divided by their sum.
    pub share: f64,
    /// Weight of planar plus axial loss.
    #[serde(default)]
    pub lambda1: f64,
    /// Weight of radial plus tangential loss.
    #[serde(default)]
    pub lambda2: f64,
    /// Weight of the local-structure loss.
    #[serde(default)]
    pub lambda3: f64,
    /// Weight of DF-Net's cross-task consistency of rigid and optical flow.
    #[serde(default)]
    pub cross_task: f64,
    /// Weight of DCPI-Depth's contextual-geometric depth consistency.
    #[serde(default)]
    pub contextual: f64,
    /// Weight of its relative difference of optical and rigid flow, which teaches the flow network only.
    #[serde(default)]
    pub rigid: f64,
    /// Weight of its agreement of the flow's divergence with the slope of the depth.
    #[serde(default)]
    pub divergence: f64,
    /// Train the flow network.
    #[serde(default)]
    pub train_flow: bool,
    /// Train the depth network.
    #[serde(default = "yes")]
    pub train_depth: bool,
    /// Train the pose network.
    #[serde(default = "yes")]
    pub train_pose: bool,
}

fn yes() -> bool {
    true
}

impl StageConfig {
    /// A stage of `l_pho` alone that trains depth and pose.
    pub fn new(name: &str, share: f64) -> Self {
        Self {
            name: name.to_owned(),
            share,
            lambda1: 0.0,
            lambda2: 0.0,
            lambda3: 0.0,
            cross_task: 0.0,
            contextual: 0.0,
            rigid: 0.0,
            divergence: 0.0,
            train_flow: false,
            train_depth: true,
            train_pose: true,
        }
    }

    /// Lengths of the paper's three stages in epochs, 30 together.
    pub const PAPER_PARTS: [f64; 3] = [5.0, 10.0, 15.0];

    /// The three stages as the paper has them.
    pub fn paper() -> Vec<Self> {
        Self::three(Self::PAPER_PARTS)
    }

    /// The same stages for small networks without pre-trained encoders, which learn little from `l_pho` alone and most from
    /// the last stage: 2, 4 and 24 parts of 30.
    pub fn nano() -> Vec<Self> {
        Self::three([2.0, 4.0, 24.0])
    }

    /// Weights (0, 0, 0.01), (0.05, 0, 0.01), (0.05, 0.1, 0.01); the flow network is trained in the first stage and frozen
    /// after. `parts` are the lengths in thirtieths of all steps.
    fn three(parts: [f64; 3]) -> Vec<Self> {
        let stage = |name: &str, parts: f64, lambda1, lambda2, train_flow| Self {
            lambda1,
            lambda2,
            lambda3: 0.01,
            train_flow,
            ..Self::new(name, parts / 30.0)
        };
        vec![
            stage("1 joint", parts[0], 0.0, 0.0, true),
            stage("2 directions", parts[1], 0.05, 0.0, false),
            stage("3 ratios", parts[2], 0.05, 0.1, false),
        ]
    }
}

/// Steps, optimiser and stages.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainConfig {
    /// Optimiser steps in all stages together.
    pub steps: u64,
    /// Snippets per step.
    pub batch: usize,
    /// Full learning rate of AdamW, reached after the warm-up.
    pub learning_rate: f64,
    /// The pose network's part of the learning rate: it starts from pre-trained weights, which the full rate shakes out of
    /// place.
    pub pose_rate: f64,
    /// Decoupled weight decay of AdamW.
    pub weight_decay: f64,
    /// Decay rates of the two running means of AdamW.
    pub betas: [f64; 2],
    /// Guard of AdamW's division.
    pub epsilon: f64,
    /// Steps over which the learning rate rises from 0, at most half of all steps.
    pub warmup: u64,
    /// How the learning rate falls after that.
    pub decay: Decay,
    /// Share of the learning rate left at the last step of a cosine decay.
    pub final_fraction: f64,
    /// Largest gradient norm of each network; 0 turns clipping off.
    pub clip_norm: f64,
    /// Mirror half of the snippets, principal point included.
    pub flip: bool,
    /// Change brightness, contrast, saturation and hue of half of the snippets.
    pub jitter: bool,
    /// Steps between checkpoints.
    pub checkpoint_every: u64,
    /// Train only these stages (numbers from 1); the steps of the others go to the last one named. None for all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub only_stages: Option<Vec<usize>>,
    /// The stages, in order.
    pub stages: Vec<StageConfig>,
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self {
            steps: 3600,
            batch: 4,
            learning_rate: 1e-3,
            pose_rate: 0.2,
            weight_decay: 1e-2,
            betas: [0.9, 0.999],
            epsilon: 1e-8,
            warmup: 100,
            decay: Decay::Cosine,
            final_fraction: 0.05,
            clip_norm: 5.0,
            flip: true,
            jitter: true,
            checkpoint_every: 250,
            only_stages: None,
            stages: LossPreset::default().stages(),
        }
    }
}

impl TrainConfig {
    /// **Errors** [`ConfigError::Value`] for the first value out of range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        require((1..=1 << 32).contains(&self.steps), "train.steps", self.steps, "must be 1 to 4294967296")?;
        require((1..=1024).contains(&self.batch), "train.batch", self.batch, "must be 1 to 1024")?;
        positive("train.learning_rate", self.learning_rate)?;
        positive("train.pose_rate", self.pose_rate)?;
        not_negative("train.weight_decay", self.weight_decay)?;
        for beta in self.betas {
            require((0.0..1.0).contains(&beta), "train.betas", beta, "must be at least 0 and below 1")?;
        }
        positive("train.epsilon", self.epsilon)?;
        fraction("train.final_fraction", self.final_fraction)?;
        not_negative("train.clip_norm", self.clip_norm)?;
        require(self.checkpoint_every >= 1, "train.checkpoint_every", self.checkpoint_every, "must be 1 or more")?;
        require(self.warmup <= 1 << 32, "train.warmup", self.warmup, "must be at most 4294967296")?;
        self.validate_stages()
    }

    fn validate_stages(&self) -> Result<(), ConfigError> {
        let count = self.stages.len();
        require((1..=32).contains(&count), "train.stages", count, "give 1 to 32 [[train.stages]] tables")?;
        for stage in &self.stages {
            positive("train.stages.share", stage.share)?;
            not_negative("train.stages.lambda1", stage.lambda1)?;
            not_negative("train.stages.lambda2", stage.lambda2)?;
            not_negative("train.stages.lambda3", stage.lambda3)?;
            not_negative("train.stages.cross_task", stage.cross_task)?;
            not_negative("train.stages.contextual", stage.contextual)?;
            not_negative("train.stages.rigid", stage.rigid)?;
            not_negative("train.stages.divergence", stage.divergence)?;
            let any = stage.train_depth || stage.train_pose || stage.train_flow;
            require(any, "train.stages", &stage.name, "a stage must train at least one network")?;
        }
        let Some(only) = &self.only_stages else { return Ok(()) };
        let shown = format!("{only:?}");
        let rising = only.windows(2).all(|pair| pair[0] < pair[1]);
        require(!only.is_empty() && rising, "train.only_stages", &shown, "name stages once and in order, for instance [1, 2]")?;
        let known = only.iter().all(|number| (1..=count).contains(number));
        require(known, "train.only_stages", &shown, &format!("stages are numbered 1 to {count}"))
    }
}
