//! How long to train, on what, and how fast.

use crate::data::synthetic::Preset;
use crate::optim::schedule::{self, Decay};

/// Settings that all tasks share.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Kinds of worlds, taken in turn.
    pub presets: Vec<Preset>,
    /// Frame width in pixels.
    pub width: usize,
    /// Frame height in pixels.
    pub height: usize,
    /// Training steps.
    pub steps: usize,
    /// Pairs in a batch.
    pub batch: usize,
    /// Peak learning rate.
    pub learning_rate: f64,
    /// Seed of weights, worlds and whatever else is drawn.
    pub seed: u64,
}

impl Settings {
    /// Steps of linear warm-up in a training of usual length; below 150 the flow network may never leave the zero-flow answer.
    const WARMUP: usize = 200;

    /// So many steps of so many pairs, the rest as usual.
    pub fn new(steps: usize, batch: usize) -> Self {
        Settings {
            presets: vec![Preset::Street, Preset::Handheld, Preset::Lateral],
            width: 128,
            height: 64,
            steps,
            batch,
            learning_rate: 1e-3,
            seed: 1,
        }
    }

    /// Learning rate of a step, counted from 0: linear warm-up, over half of the steps at most, then a cosine down to a hundredth.
    pub fn learning_rate(&self, step: usize) -> f64 {
        let warmup = Self::WARMUP.min(self.steps / 2);
        schedule::learning_rate(self.learning_rate, step, self.steps, warmup, Decay::Cosine { final_fraction: 0.01 })
    }
}
