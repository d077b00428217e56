//! The ResNet-18 encoder in training.

use std::sync::Arc;
use std::time::Duration;

use anyhow::Result;
use dimode_autodiff::{Pool, Shape, Tape, Tensor};
use dimode_nets::{Binder, Blueprint, Mode, ParamSet, ResNetConfig, ResNetEncoder};
use serde_json::{Value, json};

use crate::case::{Case, Ours, Results, seeded, timed};
use crate::inputs::Inputs;

/// Largest relative difference of a ResNet-18's gradients between two programs in f32: where rounding decides the sign before a
/// ReLU, a path opens or closes. PyTorch's own two layouts differ by up to 1.5e-2.
pub const RESNET18_GRADIENTS: f64 = 3e-2;

/// Sizes of a ResNet-18 with `width` channels behind the first convolution; 64 is the usual one.
pub fn resnet18(images: usize, width: usize) -> ResNetConfig {
    let widths = [width, width, 2 * width, 4 * width, 8 * width];
    ResNetConfig { images, widths, blocks: [2; 4], classifier: false }
}

/// An encoder at one image size.
#[derive(Clone, Debug)]
pub struct EncoderCase {
    name: String,
    width: usize,
    batch: usize,
    height: usize,
    img_width: usize,
}

impl EncoderCase {
    /// The encoder of a width on a batch of images.
    pub fn new(width: usize, batch: usize, height: usize, img_width: usize) -> Self {
        Self { name: format!("encoder width {width} {img_width}x{height} b{batch}"), width, batch, height, img_width }
    }
}

impl Case for EncoderCase {
    fn topic(&self) -> &'static str {
        "encoder"
    }

    fn name(&self) -> &str {
        &self.name
    }

    fn whats(&self) -> &'static [&'static str] {
        &["forward", "forward_backward"]
    }

    fn spec(&self) -> Value {
        json!({"name": self.name, "width": self.width, "batch": self.batch, "height": self.height, "img_width": self.img_width})
    }

    fn build(&self, inputs: &Inputs) -> Result<Box<dyn Ours + Send>> {
        let net = ResNetEncoder::new("encoder", resnet18(1, self.width));
        let mut blueprint = Blueprint::new();
        net.declare(&mut blueprint);
        let mut params = blueprint.init(1);
        inputs.parameters(&mut params)?;
        let (h, w) = (self.height, self.img_width);
        Ok(Box::new(Encoder {
            net,
            params,
            x: inputs.tensor("x", Shape::new(self.batch, 3, h, w))?,
            gy: inputs.tensor("gy", Shape::new(self.batch, 8 * self.width, h / 32, w / 32))?,
            pool: Pool::new(),
        }))
    }
}

struct Encoder {
    net: ResNetEncoder,
    params: ParamSet<f32>,
    x: Tensor<f32>,
    gy: Tensor<f32>,
    pool: Arc<Pool<f32>>,
}

impl Ours for Encoder {
    fn repetition(&mut self, what: &str) -> Duration {
        timed(|| {
            let tape = Tape::with_pool(self.pool.clone());
            let x = tape.constant(self.x.clone());
            if what == "forward" {
                let mut binder = Binder::selective(&tape, &self.params, Mode::Train, |_| false);
                self.net.forward(&mut binder, x);
            } else {
                let mut binder = Binder::new(&tape, &self.params, Mode::Train);
                let y = self.net.forward(&mut binder, x)[4];
                binder.gradients(&tape.backward_and_free(seeded(y, &self.gy)));
            }
        })
    }

    fn results(&mut self) -> Results {
        let tape = Tape::new();
        let mut binder = Binder::new(&tape, &self.params, Mode::Train);
        let y = self.net.forward(&mut binder, tape.constant(self.x.clone()))[4];
        let mut results = Results::default();
        results.tensors.push(("y".into(), y.value(), 1e-4));
        for gradient in binder.gradients(&tape.backward(seeded(y, &self.gy))) {
            results.tensors.push((format!("grad_{}", gradient.path), gradient.gradient, RESNET18_GRADIENTS));
        }
        results
    }
}
