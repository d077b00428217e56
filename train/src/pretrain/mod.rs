//! Training of a network on its own, before the joint training: where flow and pose networks begin.

pub mod flow;
pub mod pose;

use dimode_nets::{ParamGradient, ParamSet};

use crate::data::DataError;
use crate::data::synthetic::{Preset, Split, SyntheticConfig, SyntheticDataset};
use crate::optim::adamw::{AdamW, State};
use crate::optim::{clip_scale, gradient_norm};

/// Largest gradient norm of a step.
const CLIP_NORM: f64 = 1.0;

/// Rendered worlds of each kind, as many as asked for.
struct WorldKinds<'a> {
    presets: &'a [Preset],
    size: (usize, usize),
    seed: u64,
    split: Split,
    worlds: usize,
    frames: usize,
}

impl WorldKinds<'_> {
    fn open(&self) -> Result<Vec<SyntheticDataset>, DataError> {
        let one = |&preset| {
            SyntheticDataset::new(SyntheticConfig {
                preset,
                width: self.size.0,
                height: self.size.1,
                seed: self.seed,
                split: self.split,
                sequences: self.worlds,
                frames: self.frames,
                ..SyntheticConfig::default()
            })
        };
        self.presets.iter().map(one).collect()
    }
}

/// Clips the gradients by their common norm and steps every parameter.
fn step_all(optimiser: &AdamW, state: &mut State, params: &mut ParamSet<f32>, gradients: Vec<ParamGradient<f32>>, rate: f64) {
    let scale = clip_scale(gradient_norm(&gradients), CLIP_NORM);
    for gradient in gradients {
        let value = params.get(&gradient.path).expect("a bound parameter").tensor().clone();
        let next = optimiser.step(state, &gradient.path, &value, &gradient.gradient, rate, scale);
        params.set(&gradient.path, next);
    }
}
