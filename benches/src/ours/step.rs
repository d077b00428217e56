//! Whole training steps in the manner of Monodepth2, by the trainer that runs them elsewhere too: depth and pose network, minimum
//! reprojection with auto-mask and smoothness on four scales, Adam.

use std::time::Duration;

use anyhow::Result;
use dimode::batch::{Batch, Images};
use dimode::config::{Config, LossPreset, StageConfig};
use dimode::model::Model;
use dimode::optim::adamw::State;
use dimode::trainer::{StepReport, Trainer};
use dimode_autodiff::Shape;
use dimode_nets::{DepthNet, PoseNet, ResNetDepth, ResNetDepthConfig, ResNetPose, ResNetPoseConfig};
use serde::Serialize;
use serde_json::{Value, json};

use super::encoder::resnet18;
use crate::camera::camera;
use crate::case::{Case, Ours, Results, timed};
use crate::inputs::Inputs;

/// Learning rate of all steps.
const RATE: f64 = 1e-4;
/// Steps whose losses are compared.
const COMPARED: usize = 3;

/// Networks and images of a training step.
#[derive(Clone, Debug, Serialize)]
pub struct StepCase {
    name: String,
    /// Channels behind the first convolution of both encoders.
    width: usize,
    /// Channels of the depth decoder, finest level first.
    decoder: [usize; 5],
    /// Channels of the pose decoder.
    pose_width: usize,
    batch: usize,
    height: usize,
    img_width: usize,
}

impl StepCase {
    /// The networks of Monodepth2 on images of 640 x 192.
    pub fn monodepth2(batch: usize) -> Self {
        Self::of(64, [16, 32, 64, 128, 256], batch, 192, 640)
    }

    /// Networks of a quarter of that width on images of 192 x 64.
    pub fn nano(batch: usize) -> Self {
        Self::of(16, [8, 16, 16, 32, 64], batch, 64, 192)
    }

    /// Networks of a width on images of a size.
    pub fn of(width: usize, decoder: [usize; 5], batch: usize, height: usize, img_width: usize) -> Self {
        let name = format!("step width {width} {img_width}x{height} b{batch}");
        Self { name, width, decoder, pose_width: 4 * width, batch, height, img_width }
    }

    /// Floating-point operations of the convolutions of a step: forward, and twice as many backward. The pose encoder sees both
    /// sources.
    pub fn flops(&self) -> f64 {
        let pixels = (self.height * self.img_width) as f64;
        let w = self.width as f64;
        // Per pixel of the image: kernel area x inputs x outputs / pixels of the input for each of the output.
        let encoder = |images: f64| {
            let stem = 49.0 * 3.0 * images * w / 4.0;
            let layer = |level: i32| {
                let (width, area) = (w * f64::from(1 << level), 16.0 * 4.0_f64.powi(level));
                let first = if level == 0 { 9.0 * w * w } else { (9.0 + 1.0) * width * width / 2.0 };
                (first + 3.0 * 9.0 * width * width) / area
            };
            stem + (0..4).map(layer).sum::<f64>()
        };
        let skips = [0.0, w, w, 2.0 * w, 4.0 * w];
        let decoder = |level: usize| {
            let out = self.decoder[level] as f64;
            let below = if level == 4 { 8.0 * w } else { self.decoder[level + 1] as f64 };
            let head = if level < 4 { 9.0 * out } else { 0.0 };
            let area = 4.0_f64.powi(level as i32);
            9.0 * below * out / (4.0 * area) + (9.0 * (out + skips[level]) * out + head) / area
        };
        let p = self.pose_width as f64;
        let pose = encoder(2.0) + (8.0 * w * p + 18.0 * p * p + 6.0 * p) / 1024.0;
        let forward = encoder(1.0) + (0..5).map(decoder).sum::<f64>() + 2.0 * pose;
        3.0 * 2.0 * forward * pixels * self.batch as f64
    }

    fn model(&self, config: &Config) -> Model {
        let depth = ResNetDepthConfig { encoder: resnet18(1, self.width), decoder: self.decoder, scales: vec![0, 1, 2, 3] };
        let pose = ResNetPoseConfig { encoder: resnet18(2, self.width), decoder: self.pose_width, frames: 1 };
        Model {
            depth: DepthNet::ResNet(ResNetDepth::new(depth)),
            pose: PoseNet::ResNet(ResNetPose::new(pose)),
            ..Model::new(&config.nets)
        }
    }

    fn batch(&self, inputs: &Inputs) -> Result<Batch> {
        let (n, h, w) = (self.batch, self.height, self.img_width);
        let image = |name| inputs.tensor(name, Shape::new(n, 3, h, w));
        let images = Images { target: image("target")?, previous: image("previous")?, next: image("next")? };
        Ok(Batch {
            names: (0..n).map(|i| format!("sample {i}")).collect(),
            snippets: (0..n).map(|i| (i, 1)).collect(),
            flipped: vec![false; n],
            seen: images.clone(),
            plain: images,
            intrinsics: vec![camera(inputs, h, w)?; n],
            pseudo_depth: None,
        })
    }
}

/// The settings of Monodepth2, with plain Adam, no clipping and one look of the pose network.
fn settings() -> Config {
    let mut config = LossPreset::Monodepth2.config();
    config.loss.scale_anchor = 0.0;
    (config.train.weight_decay, config.train.clip_norm, config.train.pose_rate) = (0.0, 0.0, 1.0);
    let nets = &mut config.nets;
    (nets.rotation_scale, nets.tangential_scale, nets.radial_scale) = (1.0, 1.0, 1.0);
    (nets.min_depth, nets.max_depth, nets.pose_iterations) = (0.1, 100.0, 1);
    config
}

impl Case for StepCase {
    fn topic(&self) -> &'static str {
        "step"
    }

    fn name(&self) -> &str {
        &self.name
    }

    fn whats(&self) -> &'static [&'static str] {
        &["step"]
    }

    fn spec(&self) -> Value {
        json!(self)
    }

    fn build(&self, inputs: &Inputs) -> Result<Box<dyn Ours + Send>> {
        let config = settings();
        let model = self.model(&config);
        let mut weights = model.init(1);
        inputs.parameters(&mut weights.depth)?;
        inputs.parameters(&mut weights.pose)?;
        let mut trainer = Trainer::new(&config, weights, State::default());
        trainer.model = model;
        Ok(Box::new(Step { trainer, batch: self.batch(inputs)?, stage: StageConfig::new("all", 1.0), taken: 0 }))
    }
}

struct Step {
    trainer: Trainer,
    batch: Batch,
    stage: StageConfig,
    taken: u64,
}

impl Step {
    fn step(&mut self) -> StepReport {
        self.taken += 1;
        self.trainer.step(&self.batch, None, &self.stage, self.taken, RATE, false).expect("a finite step")
    }
}

impl Ours for Step {
    fn repetition(&mut self, _: &str) -> Duration {
        timed(|| self.step())
    }

    /// Takes the first steps, so it must come before everything else.
    fn results(&mut self) -> Results {
        assert!(self.taken == 0, "the first steps are the ones to compare");
        let mut results = Results::default();
        for i in 0..COMPARED {
            let report = self.step();
            // Every step of Adam moves each weight by its full rate at first, whatever its gradient: small differences grow.
            results.values.push((format!("loss_{i}"), report.total, if i == 0 { 1e-4 } else { 3e-3 }));
            if i == 0 {
                let norms = report.network_gradients;
                for (name, norm) in [("depth_gradient", norms[0]), ("pose_gradient", norms[1])] {
                    results.values.push((name.into(), norm.expect("a trained network"), 1e-2));
                }
            }
        }
        results
    }
}
