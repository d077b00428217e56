//! The flow network: supervised on rendered pairs with exact flow, the stand-in for FlyingChairs.
//!
//! Every step renders new worlds, so no pair is seen twice. Loss, optimiser and schedule follow RAFT at small scale: weighted
//! sequence loss, AdamW, one warm-up and a decay to zero, gradient norm clipped at 1.

use anyhow::{Context, Result};
use dimode_autodiff::{Shape, Tensor, Var};
use dimode_nets::{Binder, FlowNet, FlowNetKind, Network, ParamSet};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::target::Form;
use super::task::Task;
use super::worlds::Worlds;
use crate::batch::join;
use crate::data::synthetic::Split;
use crate::data::{Dataset, Frame, Jitter, PairTruth};
use crate::losses::raft_sequence::raft_sequence;
use crate::mirror::{mirrored, mirrored_flow};
use crate::model::stack;

/// A flow network that learns the exact flow of rendered pairs.
#[derive(Clone, Debug)]
pub struct FlowTask {
    net: FlowNet,
    iterations: usize,
}

impl FlowTask {
    /// Usual number of refinements.
    pub const ITERATIONS: usize = 4;

    /// A network of the given size that refines its flow `iterations` times. Batch norms learn their statistics here; training
    /// keeps them.
    pub fn new(net: FlowNetKind, iterations: usize) -> Self {
        FlowTask { net: FlowNet::new(net.config().learning_statistics()), iterations }
    }
}

/// Pairs of frames with known flow, `[n, c, h, w]` each.
#[derive(Clone, Debug)]
pub struct FlowBatch {
    /// The frames that the flow begins in.
    pub first: Tensor<f32>,
    /// The frames that it ends in.
    pub second: Tensor<f32>,
    /// Flow from first to second, pixels.
    pub truth: Tensor<f32>,
    /// Where it is known, 0 or 1.
    pub valid: Tensor<f32>,
}

impl Task for FlowTask {
    type Batch = FlowBatch;

    const NETWORK: &'static str = "flow";
    const FORM: Form = Form::File("raft");
    const MEASURE: &'static str = "end-point error";
    const BASELINE: &'static str = "zero flow";
    const STREAM: u64 = 0x666c_6f77;
    const STEPS: usize = 5000;
    const BATCH: usize = 4;
    const LOOK_EVERY: usize = 250;
    const LOOK_PAIRS: usize = 4;
    const FINAL_PAIRS: usize = 24;

    fn init(&self, seed: u64) -> ParamSet<f32> {
        self.net.init(seed)
    }

    /// Pairs of a step, mostly neighbouring frames, in either direction; augmented in training.
    fn batch(&self, worlds: &Worlds, step: usize, pairs: usize) -> Result<FlowBatch> {
        let augment = worlds.split() == Split::Train;
        let samples = worlds.samples(step, pairs, |dataset, world, index, mut rng| {
            let (a, b) = if augment { FRAME_PAIRS[rng.random_range(0..FRAME_PAIRS.len())] } else { (index % 2, 1 - index % 2) };
            let (first, second) = (dataset.frame(world, a)?, dataset.frame(world, b)?);
            let truth = dataset.pair_truth(world, a, b)?.context("rendered worlds know their flow")?;
            Ok(sample(&first, &second, &truth, augment.then_some(&mut rng)))
        })?;
        let joined = |k: usize| join(&samples.iter().map(|sample| &sample[k]).collect::<Vec<_>>());
        Ok(FlowBatch { first: joined(0), second: joined(1), truth: joined(2), valid: joined(3) })
    }

    fn loss<'t>(&self, binder: &mut Binder<'t, f32>, batch: &FlowBatch) -> Var<'t, f32> {
        let tape = binder.tape();
        let (first, second) = (tape.constant(batch.first.clone()), tape.constant(batch.second.clone()));
        raft_sequence(&self.net.forward(binder, first, second, self.iterations), &batch.truth, &batch.valid)
    }

    /// Mean end-point errors over all pixels with known depth.
    fn errors(&self, params: &ParamSet<f32>, batch: &FlowBatch) -> [f64; 2] {
        let predicted = self.net.predict(params, &batch.first, &batch.second, Some(self.iterations));
        let zero = Tensor::zeros(predicted.shape());
        [predicted, zero].map(|flow| end_point_error(&flow, &batch.truth, &batch.valid))
    }
}

/// Mean length of the difference of two flows `[n, 2, h, w]` over valid pixels.
pub fn end_point_error(flow: &Tensor<f32>, truth: &Tensor<f32>, valid: &Tensor<f32>) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for n in 0..flow.shape().n() {
        let (u, v) = (flow.plane(n, 0), flow.plane(n, 1));
        let (tu, tv) = (truth.plane(n, 0), truth.plane(n, 1));
        for (i, &valid) in valid.plane(n, 0).iter().enumerate() {
            if valid > 0.0 {
                sum += f64::from(u[i] - tu[i]).hypot(f64::from(v[i] - tv[i]));
                count += 1.0;
            }
        }
    }
    sum / f64::max(count, 1.0)
}

/// Frame numbers of training pairs: neighbours four times out of five, else two apart.
const FRAME_PAIRS: [(usize, usize); 10] = [(0, 1), (1, 0), (1, 2), (2, 1), (2, 3), (3, 2), (0, 1), (3, 2), (0, 2), (3, 1)];

/// Images, flow and validity of a pair as `[1, c, h, w]` tensors, augmented when a generator is given.
fn sample(first: &Frame, second: &Frame, truth: &PairTruth, rng: Option<&mut ChaCha8Rng>) -> [Tensor<f32>; 4] {
    let (mut a, mut b) = (stack([&first.image]), stack([&second.image]));
    let plane = Shape::new(1, 1, first.image.height, first.image.width);
    let flow: Vec<f32> = truth.flow.u.iter().chain(&truth.flow.v).copied().collect();
    let mut flow = Tensor::from_vec(plane.with_c(2), flow);
    let known = |i: usize| {
        let depth = first.depth.as_ref().is_none_or(|d| d.data[i] > 0.0);
        if depth && truth.flow.u[i].is_finite() && truth.flow.v[i].is_finite() { 1.0 } else { 0.0 }
    };
    let mut valid = Tensor::from_vec(plane, (0..plane.len()).map(known).collect());
    flow = Tensor::from_vec(flow.shape(), flow.data().iter().map(|f| if f.is_finite() { *f } else { 0.0 }).collect());
    if let Some(rng) = rng {
        let jitter = Jitter::draw(rng);
        let apart = rng.random::<f64>() < 0.2;
        let other = if apart { Jitter::draw(rng) } else { jitter };
        a = stack([&jitter.apply(&first.image)]);
        b = stack([&other.apply(&second.image)]);
        if rng.random::<f64>() < 0.5 {
            [a, b, flow, valid] = [mirrored(&a), mirrored(&b), mirrored_flow(&flow), mirrored(&valid)];
        }
    }
    [a, b, flow, valid]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn end_point_error_ignores_invalid_pixels() {
        let flow = Tensor::from_vec(Shape::new(1, 2, 1, 2), vec![3.0, 9.0, 4.0, 9.0]);
        let truth = Tensor::zeros(flow.shape());
        let valid = Tensor::from_vec(Shape::new(1, 1, 1, 2), vec![1.0, 0.0]);
        assert_eq!(end_point_error(&flow, &truth, &valid), 5.0);
    }
}
