//! What is timed: a case knows its sizes and builds what can be run.

use std::time::{Duration, Instant};

use anyhow::Result;
use dimode_autodiff::{Tape, Tensor, Var};
use serde_json::Value;

use crate::Inputs;

/// A computation of fixed size, described so that a peer can build the same.
pub trait Case {
    /// Module of the peer that builds it.
    fn topic(&self) -> &'static str;
    /// Name, unique within a run.
    fn name(&self) -> &str;
    /// What can be timed.
    fn whats(&self) -> &'static [&'static str];
    /// Sizes, as the peer's module reads them.
    fn spec(&self) -> Value;
    /// Builds it from its inputs.
    ///
    /// # Errors
    /// When an input is missing.
    fn build(&self, inputs: &Inputs) -> Result<Box<dyn Ours + Send>>;
}

/// A case that is ready to run.
pub trait Ours {
    /// Runs `what` once and returns how long it took, preparations left out.
    fn repetition(&mut self, what: &str) -> Duration;
    /// Computes everything once, for a comparison with a peer's numbers.
    fn results(&mut self) -> Results;
}

/// Numbers to compare, each with the largest relative difference that is accepted.
#[derive(Debug, Default)]
pub struct Results {
    /// Arrays by name; the difference is measured by their Euclidean norms.
    pub tensors: Vec<(String, Tensor<f32>, f64)>,
    /// Single numbers by name.
    pub values: Vec<(String, f64, f64)>,
}

/// How long `run` takes; what it returns is dropped within the time, as a program would.
pub fn timed<R>(run: impl FnOnce() -> R) -> Duration {
    let start = Instant::now();
    drop(run());
    start.elapsed()
}

/// A scalar whose gradient with respect to `y` is the given one: `<gradient, y>` without its value, so that a backward pass
/// from a known gradient costs nothing beside it.
pub fn seeded<'t>(y: Var<'t, f32>, gradient: &Tensor<f32>) -> Var<'t, f32> {
    assert!(y.shape() == gradient.shape(), "seeded: {} and {} differ", y.shape(), gradient.shape());
    let gradient = gradient.clone();
    y.tape().push("seeded", Tensor::scalar(0.0), &[y], move |_, grads| {
        if let Some(mut slot) = grads.slot(0) {
            slot.add_tensor(&gradient);
        }
    })
}

/// A leaf where the gradient is wanted, else a constant.
pub fn input<'t>(tape: &'t Tape<f32>, value: &Tensor<f32>, wanted: bool) -> Var<'t, f32> {
    if wanted { tape.leaf(value.clone()) } else { tape.constant(value.clone()) }
}
