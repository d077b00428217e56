//! Depth, pose and flow network as configurations name them, in training.

use std::sync::Arc;
use std::time::Duration;

use anyhow::Result;
use dimode::config::NetsConfig;
use dimode::model::Model;
use dimode_autodiff::{Pool, Shape, Tape, Tensor, Var};
use dimode_nets::{Binder, DepthNetKind, FlowNetKind, Mode, ParamSet, PoseNetKind};
use serde_json::{Value, json};

use super::encoder::RESNET18_GRADIENTS;
use super::sizes;
use crate::case::{Case, Ours, Results, timed};
use crate::inputs::Inputs;

/// Which network.
#[derive(Clone, Copy, Debug)]
enum Which {
    Depth,
    Pose,
    Flow,
}

/// A network of a configuration on a batch of images.
#[derive(Clone, Debug)]
pub struct NetworkCase {
    name: String,
    which: Which,
    nets: NetsConfig,
    images: Shape,
    /// Largest relative difference of its gradients between two programs in f32.
    accepted: f64,
}

impl NetworkCase {
    /// The nano networks at 128 x 64; depth and pose network of ResNet-18 size, Lite-Mono and the small RAFT at 640 x 192.
    pub fn all() -> Vec<Self> {
        let nano = NetsConfig::default();
        let large = NetsConfig { depth: DepthNetKind::Resnet18, pose: PoseNetKind::Resnet18, ..NetsConfig::default() };
        let lite = |depth| NetsConfig { depth, ..NetsConfig::default() };
        let (nano_lite, lite) = (lite(DepthNetKind::NanoLiteMono), lite(DepthNetKind::LiteMono));
        let small_raft = NetsConfig { flow: FlowNetKind::RaftSmall, flow_iterations: 12, ..NetsConfig::default() };
        let case = |name: &str, which, nets: &NetsConfig, images, accepted| {
            let (name, nets) = (name.into(), nets.clone());
            Self { name, which, nets, images, accepted }
        };
        let (small, full) = (Shape::new(8, 3, 64, 128), Shape::new(1, 3, 192, 640));
        vec![
            case("nano depth 128x64 b8", Which::Depth, &nano, small, 1e-3),
            case("nano pose 128x64 b8", Which::Pose, &nano, small, 1e-3),
            case("nano flow 128x64 b8", Which::Flow, &nano, small, 2e-2),
            case("resnet18 depth 640x192 b1", Which::Depth, &large, full, RESNET18_GRADIENTS),
            case("resnet18 pose 640x192 b1", Which::Pose, &large, full, RESNET18_GRADIENTS),
            case("nano lite-mono 128x64 b8", Which::Depth, &nano_lite, small, 1e-3),
            case("lite-mono 640x192 b1", Which::Depth, &lite, full, 1e-2),
            case("raft-small 640x192 b1", Which::Flow, &small_raft, full, 2e-2),
        ]
    }

    /// Sizes of the network, by the names that the peer gives them.
    fn sizes(&self) -> Value {
        let NetsConfig { rotation_scale, tangential_scale, radial_scale, flow_iterations, .. } = self.nets;
        match self.which {
            Which::Depth => sizes::depth(&self.nets.depth.config()),
            Which::Pose => sizes::pose(&self.nets.pose.config(), [rotation_scale, tangential_scale, radial_scale]),
            Which::Flow => sizes::flow(&self.nets.flow.config(), flow_iterations),
        }
    }
}

impl Case for NetworkCase {
    fn topic(&self) -> &'static str {
        "networks"
    }

    fn name(&self) -> &str {
        &self.name
    }

    fn whats(&self) -> &'static [&'static str] {
        &["forward", "forward_backward"]
    }

    fn spec(&self) -> Value {
        json!({"name": self.name, "images": self.images.0, "sizes": self.sizes()})
    }

    fn build(&self, inputs: &Inputs) -> Result<Box<dyn Ours + Send>> {
        let model = Model::new(&self.nets);
        let weights = model.init(1);
        let mut params = match self.which {
            Which::Depth => weights.depth,
            Which::Pose => weights.pose,
            Which::Flow => weights.flow,
        };
        inputs.parameters(&mut params)?;
        let (first, second) = (inputs.tensor("target", self.images)?, inputs.tensor("next", self.images)?);
        let images = [first, second];
        Ok(Box::new(Network { which: self.which, model, params, images, accepted: self.accepted, pool: Pool::new() }))
    }
}

struct Network {
    which: Which,
    model: Model,
    params: ParamSet<f32>,
    images: [Tensor<f32>; 2],
    accepted: f64,
    pool: Arc<Pool<f32>>,
}

impl Network {
    /// Everything that the network says.
    fn outputs<'t>(&self, binder: &mut Binder<'t, f32>) -> Vec<Var<'t, f32>> {
        let tape = binder.tape();
        let [first, second] = self.images.each_ref().map(|image| tape.constant(image.clone()));
        match self.which {
            Which::Depth => self.model.depth.forward(binder, first),
            Which::Pose => self.model.motion(binder, first, second).to_vec(),
            Which::Flow => self.model.flow.forward(binder, first, second, self.model.flow_iterations),
        }
    }

    /// Whether the gradient of a parameter is nothing but rounding: a bias before a norm, which takes it away.
    fn has_no_gradient(path: &str) -> bool {
        path.starts_with("raft:fnet.") && path.ends_with(".bias") && path != "raft:fnet.conv2.bias"
    }
}

/// The sum of all outputs: what the backward pass starts from.
fn sum<'t>(outputs: &[Var<'t, f32>]) -> Var<'t, f32> {
    outputs.iter().map(|output| output.sum()).reduce(Var::add).expect("a network says something")
}

impl Ours for Network {
    fn repetition(&mut self, what: &str) -> Duration {
        timed(|| {
            let tape = Tape::with_pool(self.pool.clone());
            let learns = what == "forward_backward";
            let mut binder = Binder::selective(&tape, &self.params, Mode::Train, |_| learns);
            let outputs = self.outputs(&mut binder);
            if learns {
                binder.gradients(&tape.backward_and_free(sum(&outputs)));
            }
        })
    }

    fn results(&mut self) -> Results {
        let tape = Tape::new();
        let mut binder = Binder::new(&tape, &self.params, Mode::Train);
        let outputs = self.outputs(&mut binder);
        let mut results = Results::default();
        for (i, output) in outputs.iter().enumerate() {
            results.tensors.push((format!("y{i}"), output.value(), 1e-4));
        }
        for gradient in binder.gradients(&tape.backward(sum(&outputs))) {
            if !Self::has_no_gradient(&gradient.path) {
                results.tensors.push((format!("grad_{}", gradient.path), gradient.gradient, self.accepted));
            }
        }
        results
    }
}
