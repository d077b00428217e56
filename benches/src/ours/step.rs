//! Whole training steps by the trainer that runs them elsewhere too: depth and pose network with minimum reprojection, auto-mask and
//! smoothness on every scale in the manner of Monodepth2; a flow network with its own photometric loss beside them; Adam.

use std::time::Duration;

use anyhow::Result;
use dimode::batch::{Batch, Images};
use dimode::config::{Config, LossPreset, StageConfig};
use dimode::model::{Model, Weights};
use dimode::optim::adamw::State;
use dimode::trainer::{StepReport, Trainer};
use dimode_autodiff::{Shape, Tape, Tensor};
use dimode_nets::{
    Binder, DepthNet, DepthNetConfig, FlowNet, FlowNetConfig, LiteMonoConfig, PoseNet, PoseNetConfig, ResNetDepthConfig,
    ResNetPoseConfig,
};
use serde_json::{Value, json};

use super::encoder::resnet18;
use super::sizes;
use crate::camera::camera;
use crate::case::{Case, Ours, Results, timed};
use crate::inputs::Inputs;

/// Learning rate of all steps.
const RATE: f64 = 1e-4;
/// Steps whose losses are compared.
const COMPARED: usize = 3;

/// Networks and images of a training step.
#[derive(Clone, Debug)]
pub struct StepCase {
    name: String,
    depth: DepthNetConfig,
    pose: PoseNetConfig,
    /// Trained by its own loss when there is one.
    flow: Option<FlowNetConfig>,
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

    /// Monodepth2's networks, with `width` channels behind the first convolution of both encoders and the channels of the depth
    /// decoder, finest level first, on images of a size.
    pub fn of(width: usize, decoder: [usize; 5], batch: usize, height: usize, img_width: usize) -> Self {
        let depth = ResNetDepthConfig { encoder: resnet18(1, width), decoder, scales: vec![0, 1, 2, 3] };
        let pose = ResNetPoseConfig { encoder: resnet18(2, width), decoder: 4 * width, frames: 1 };
        Self {
            name: format!("step width {width} {img_width}x{height} b{batch}"),
            depth: DepthNetConfig::ResNet(depth),
            pose: PoseNetConfig::ResNet(pose),
            flow: None,
            batch,
            height,
            img_width,
        }
    }

    /// The networks of the paper on an image of 640 x 192, all three trained: Lite-Mono, ResNet-18 for the pose, the small RAFT with
    /// 12 refinements. No path is dropped, so that both sides do the same.
    pub fn paper() -> Self {
        Self {
            name: "step lite-mono, resnet18, raft-small 640x192 b1".into(),
            depth: DepthNetConfig::LiteMono(LiteMonoConfig { drop_path: 0.0, ..LiteMonoConfig::lite_mono() }),
            pose: PoseNetConfig::resnet18(),
            flow: Some(FlowNetConfig::raft_small()),
            batch: 1,
            height: 192,
            img_width: 640,
        }
    }

    /// Floating-point operations of the convolutions of depth and pose network in a step: forward, and twice as many backward. The
    /// pose network sees both sources.
    pub fn flops(&self) -> f64 {
        let model = self.model(&settings());
        let Weights { depth, pose, .. } = model.init(1);
        let tape = Tape::<f32>::new();
        let [mut of_depth, mut of_pose] = [&depth, &pose].map(|set| Binder::frozen(&tape, set));
        let images = |n| tape.constant(Tensor::zeros(Shape::new(n, 3, self.height, self.img_width)));
        model.depth.forward(&mut of_depth, images(self.batch));
        let (first, second) = (images(2 * self.batch), images(2 * self.batch));
        model.pose.forward(&mut of_pose, first, second);
        3.0 * 2.0 * (of_depth.macs() + of_pose.macs()) as f64
    }

    fn model(&self, config: &Config) -> Model {
        let base = Model::new(&config.nets);
        let flow_iterations = self.flow.as_ref().map_or(base.flow_iterations, |flow| flow.iterations);
        Model {
            depth: DepthNet::new(self.depth.clone()),
            pose: PoseNet::new(self.pose.clone()),
            flow: self.flow.clone().map_or(base.flow, FlowNet::new),
            flow_iterations,
            ..base
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

/// The settings of Monodepth2, with plain Adam at one rate, no clipping and one look of the pose network.
fn settings() -> Config {
    let mut config = LossPreset::Monodepth2.config();
    config.loss.scale_anchor = 0.0;
    config.loss.flow.rate = 1.0;
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
        json!({
            "name": self.name, "depth": sizes::depth(&self.depth), "pose": sizes::pose(&self.pose, [1.0; 3]),
            "flow": self.flow.as_ref().map(|flow| sizes::flow(flow, flow.iterations)), "batch": self.batch,
            "height": self.height, "img_width": self.img_width
        })
    }

    fn build(&self, inputs: &Inputs) -> Result<Box<dyn Ours + Send>> {
        let config = settings();
        let model = self.model(&config);
        let mut weights = model.init(1);
        inputs.parameters(&mut weights.depth)?;
        inputs.parameters(&mut weights.pose)?;
        if self.flow.is_some() {
            inputs.parameters(&mut weights.flow)?;
        }
        let mut trainer = Trainer::new(&config, weights, State::default());
        trainer.model = model;
        let stage = StageConfig { train_flow: self.flow.is_some(), ..StageConfig::new("all", 1.0) };
        Ok(Box::new(Step { trainer, batch: self.batch(inputs)?, stage, taken: 0 }))
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
                let names = ["depth_gradient", "pose_gradient", "flow_gradient"];
                for (name, norm) in names.into_iter().zip(report.network_gradients) {
                    results.values.extend(norm.map(|norm| (name.into(), norm, 1e-2)));
                }
            }
        }
        results
    }
}
