//! Depth, pose and flow network as configurations name them, in training.

use std::sync::Arc;
use std::time::Duration;

use anyhow::Result;
use dimode::config::NetsConfig;
use dimode::model::Model;
use dimode_autodiff::{Pool, Shape, Tape, Tensor, Var};
use dimode_nets::{Binder, DepthNetKind, Mode, ParamSet, PoseNetKind};
use serde_json::{Value, json};

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
}

impl NetworkCase {
    /// The nano networks at 128 x 64, and depth and pose network of ResNet-18 size at 640 x 192.
    pub fn all() -> Vec<Self> {
        let nano = NetsConfig::default();
        let large = NetsConfig { depth: DepthNetKind::Resnet18, pose: PoseNetKind::Resnet18, ..NetsConfig::default() };
        let case = |name: &str, which, nets: &NetsConfig, images| Self { name: name.into(), which, nets: nets.clone(), images };
        let (small, full) = (Shape::new(8, 3, 64, 128), Shape::new(1, 3, 192, 640));
        vec![
            case("nano depth 128x64 b8", Which::Depth, &nano, small),
            case("nano pose 128x64 b8", Which::Pose, &nano, small),
            case("nano flow 128x64 b8", Which::Flow, &nano, small),
            case("resnet18 depth 640x192 b1", Which::Depth, &large, full),
            case("resnet18 pose 640x192 b1", Which::Pose, &large, full),
        ]
    }
}

impl Case for NetworkCase {
    fn topic(&self) -> &'static str {
        "network"
    }

    fn name(&self) -> &str {
        &self.name
    }

    fn whats(&self) -> &'static [&'static str] {
        &["forward", "forward_backward"]
    }

    fn spec(&self) -> Value {
        json!({"name": self.name, "images": self.images.0})
    }

    fn build(&self, inputs: &Inputs) -> Result<Box<dyn Ours + Send>> {
        let model = Model::new(&self.nets);
        let weights = model.init(1);
        let params = match self.which {
            Which::Depth => weights.depth,
            Which::Pose => weights.pose,
            Which::Flow => weights.flow,
        };
        let (first, second) = (inputs.tensor("target", self.images)?, inputs.tensor("next", self.images)?);
        Ok(Box::new(Network { which: self.which, model, params, images: [first, second], pool: Pool::new() }))
    }
}

struct Network {
    which: Which,
    model: Model,
    params: ParamSet<f32>,
    images: [Tensor<f32>; 2],
    pool: Arc<Pool<f32>>,
}

impl Network {
    /// The sum of everything that the network says.
    fn said<'t>(&self, binder: &mut Binder<'t, f32>) -> Var<'t, f32> {
        let tape = binder.tape();
        let [first, second] = self.images.each_ref().map(|image| tape.constant(image.clone()));
        let outputs = match self.which {
            Which::Depth => self.model.depth.forward(binder, first),
            Which::Pose => self.model.motion(binder, first, second).to_vec(),
            Which::Flow => self.model.flow.forward(binder, first, second, self.model.flow_iterations),
        };
        outputs.into_iter().map(Var::sum).reduce(Var::add).expect("a network says something")
    }
}

impl Ours for Network {
    fn repetition(&mut self, what: &str) -> Duration {
        timed(|| {
            let tape = Tape::with_pool(self.pool.clone());
            let learns = what == "forward_backward";
            let mut binder = Binder::selective(&tape, &self.params, Mode::Train, |_| learns);
            let said = self.said(&mut binder);
            if learns {
                binder.gradients(&tape.backward_and_free(said));
            }
        })
    }

    /// No peer has these networks.
    fn results(&mut self) -> Results {
        Results::default()
    }
}
