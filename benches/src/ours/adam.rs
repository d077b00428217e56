//! Adam's step over some parameter tensors.

use std::time::Duration;

use anyhow::Result;
use dimode::optim::adamw::{AdamW, State};
use dimode_autodiff::{Shape, Tensor};
use serde_json::{Value, json};

use crate::case::{Case, Ours, Results, timed};
use crate::inputs::Inputs;

/// Learning rate: large, so that the steps show beside the weights when numbers are compared.
const RATE: f64 = 1e-2;

/// Convolution weights of a ResNet-18, from its narrow layers and its wide ones.
const SHAPES: [[usize; 4]; 5] = [[64, 3, 7, 7], [64, 64, 3, 3], [128, 128, 3, 3], [256, 256, 3, 3], [512, 512, 3, 3]];

/// Adam without decay over 3.1 million weights in five tensors.
#[derive(Clone, Copy, Debug)]
pub struct AdamCase;

impl Case for AdamCase {
    fn topic(&self) -> &'static str {
        "adam"
    }

    fn name(&self) -> &str {
        "Adam 3.1 million weights"
    }

    fn whats(&self) -> &'static [&'static str] {
        &["step"]
    }

    fn spec(&self) -> Value {
        json!({"name": self.name(), "shapes": SHAPES, "rate": RATE})
    }

    fn build(&self, inputs: &Inputs) -> Result<Box<dyn Ours + Send>> {
        let tensors = |kind: &str| -> Result<Vec<_>> {
            SHAPES.iter().enumerate().map(|(i, shape)| inputs.tensor(&format!("{kind}{i}"), Shape(*shape))).collect()
        };
        let names = (0..SHAPES.len()).map(|i| format!("w{i}")).collect();
        Ok(Box::new(Adam { names, weights: tensors("w")?, gradients: [tensors("g")?, tensors("h")?], state: State::default() }))
    }
}

struct Adam {
    names: Vec<String>,
    weights: Vec<Tensor<f32>>,
    /// Those of even and of odd steps.
    gradients: [Vec<Tensor<f32>>; 2],
    state: State,
}

impl Adam {
    fn step(&mut self, which: usize) {
        let rule = AdamW { weight_decay: 0.0, ..AdamW::default() };
        for ((name, weight), gradient) in self.names.iter().zip(&mut self.weights).zip(&self.gradients[which]) {
            rule.step(&mut self.state, name, weight.make_mut(), gradient, RATE, 1.0);
        }
    }
}

impl Ours for Adam {
    fn repetition(&mut self, _: &str) -> Duration {
        timed(|| self.step(0))
    }

    /// Takes the first two steps, so it must come before everything else.
    fn results(&mut self) -> Results {
        self.step(0);
        self.step(1);
        let tensors = self.names.iter().zip(&self.weights).map(|(name, weight)| (name.clone(), weight.clone(), 1e-5));
        Results { tensors: tensors.collect(), values: Vec::new() }
    }
}
