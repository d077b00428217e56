//! What a network learns from on its own.

use anyhow::Result;
use dimode_autodiff::Var;
use dimode_nets::{Binder, ParamSet};

use super::target::Form;
use super::worlds::Worlds;

/// A network, the batches that it learns from, its loss, and how its error is measured.
pub trait Task: Sync {
    /// The data of one step.
    type Batch: Sync;

    /// Which network it is, for messages.
    const NETWORK: &'static str;
    /// The files that hold its weights.
    const FORM: Form;
    /// What [`Task::errors`] measures, in pixels.
    const MEASURE: &'static str;
    /// The answer that the network is compared with.
    const BASELINE: &'static str;
    /// Mixed into the seed, so that tasks of one seed draw different numbers.
    const STREAM: u64;
    /// Usual number of steps.
    const STEPS: usize;
    /// Usual number of pairs in a batch.
    const BATCH: usize;
    /// Steps from one look at held-out worlds to the next.
    const LOOK_EVERY: usize;
    /// Pairs of each kind of worlds in such a look.
    const LOOK_PAIRS: usize;
    /// Pairs of each kind of worlds in the look at the end.
    const FINAL_PAIRS: usize;

    /// Weights to begin with.
    fn init(&self, seed: u64) -> ParamSet<f32>;

    /// The data of a step, counted from 0.
    ///
    /// # Errors
    /// When a frame cannot be rendered.
    fn batch(&self, worlds: &Worlds, step: usize, pairs: usize) -> Result<Self::Batch>;

    /// The loss of a batch.
    fn loss<'t>(&self, binder: &mut Binder<'t, f32>, batch: &Self::Batch) -> Var<'t, f32>;

    /// Mean errors of a batch in pixels: of the network, and of the answer that it is compared with.
    fn errors(&self, params: &ParamSet<f32>, batch: &Self::Batch) -> [f64; 2];
}
