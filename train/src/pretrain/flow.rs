//! The flow network: supervised on rendered pairs with exact flow, the stand-in for FlyingChairs.
//!
//! Every step renders new worlds, so no pair is seen twice. Loss, optimiser and schedule follow RAFT at small scale: weighted
//! sequence loss, AdamW, one warm-up and a decay to zero, gradient norm clipped at 1.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result, bail};
use dimode_autodiff::{Pool, Shape, Tape, Tensor, par};
use dimode_nets::{Binder, FlowNet, FlowNetKind, Mode, Network, ParamSet, weights};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{WorldKinds, step_all};
use crate::data::synthetic::{Preset, Split, SyntheticDataset};
use crate::data::{Dataset, Frame, PairTruth};
use crate::losses::raft_sequence::raft_sequence;
use crate::mirror::{mirrored, mirrored_flow};
use crate::model::stack;
use crate::optim::adamw::{AdamW, State};
use crate::optim::schedule::{Decay, learning_rate};
use crate::progress::Progress;

/// Settings of the pre-training.
#[derive(Clone, Debug, PartialEq)]
pub struct PretrainConfig {
    /// Size of the network.
    pub flow: FlowNetKind,
    /// Kinds of worlds, taken in turn.
    pub presets: Vec<Preset>,
    /// Image width in pixels.
    pub width: usize,
    /// Image height in pixels.
    pub height: usize,
    /// Training steps.
    pub steps: usize,
    /// Pairs in a batch.
    pub batch: usize,
    /// Refinements of the network.
    pub iterations: usize,
    /// Peak learning rate.
    pub learning_rate: f64,
    /// Steps of linear warm-up; below 150 the network may never leave the zero-flow answer.
    pub warmup: usize,
    /// Seed of weights, worlds and augmentation.
    pub seed: u64,
}

impl Default for PretrainConfig {
    fn default() -> Self {
        PretrainConfig {
            flow: FlowNetKind::NanoRaftD4,
            presets: vec![Preset::Street, Preset::Handheld, Preset::Lateral],
            width: 128,
            height: 64,
            steps: 5000,
            batch: 4,
            iterations: 4,
            learning_rate: 1e-3,
            warmup: 200,
            seed: 1,
        }
    }
}

/// What to do and where to write.
#[derive(Clone, Debug)]
pub struct PretrainRequest {
    /// Weights file (safetensors) to write.
    pub out: PathBuf,
    /// Settings.
    pub config: PretrainConfig,
}

/// Mean end-point error on held-out worlds of one kind, in pixels, over all pixels with known depth.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct EndPointError {
    /// Kind of worlds.
    pub preset: String,
    /// Of the network.
    pub network: f64,
    /// Of zero flow.
    pub zero: f64,
    /// Pairs measured.
    pub pairs: usize,
}

/// Trains the flow network and writes its weights; returns the error on held-out worlds.
///
/// # Errors
/// When interrupted, when the loss becomes non-finite, or when the file cannot be written.
pub fn train(request: &PretrainRequest, progress: &dyn Progress, stop: &AtomicBool) -> Result<Vec<EndPointError>> {
    par::inside(|| run(request, progress, stop))
}

fn run(request: &PretrainRequest, progress: &dyn Progress, stop: &AtomicBool) -> Result<Vec<EndPointError>> {
    let config = &request.config;
    let net = FlowNet::new(config.flow.config());
    let mut params: ParamSet<f32> = net.init(config.seed);
    let worlds = Worlds::new(config, Split::Train)?;
    let optimiser = AdamW { weight_decay: 1e-4, ..AdamW::default() };
    let mut state = State::default();
    let pool = Pool::new();
    progress.start(config.steps as u64, "pre-training flow");
    for step in 0..config.steps {
        if stop.load(Ordering::Relaxed) {
            bail!("interrupted at step {step}; nothing was written");
        }
        let batch = worlds.batch(step, true)?;
        let tape = Tape::with_pool(pool.clone());
        let binder = Binder::new(&tape, &params, Mode::Train);
        let (first, second) = (tape.constant(batch.first), tape.constant(batch.second));
        let flows = net.forward(&binder, first, second, config.iterations);
        let loss = raft_sequence(&flows, &batch.truth, &batch.valid);
        let value = f64::from(loss.value().item());
        if !value.is_finite() {
            bail!("pre-training flow: the loss became {value} at step {step}; lower the learning rate");
        }
        let gradients = binder.gradients(&tape.backward_and_free(loss));
        let rate = learning_rate(config.learning_rate, step, config.steps, config.warmup, Decay::Cosine { final_fraction: 0.01 });
        step_all(&optimiser, &mut state, &mut params, gradients, rate);
        progress.step(step as u64 + 1, &format!("loss {value:.3}"));
        if (step + 1) % 250 == 0 {
            let errors = evaluate(config, &net, &params, 4)?;
            let text: Vec<_> = errors.iter().map(|e| format!("{} {:.3} px", e.preset, e.network)).collect();
            progress.note(&format!("step {}: end-point error {}", step + 1, text.join(", ")));
        }
    }
    progress.finish();
    let file = params.file("raft").context("the flow network has one file, raft")?;
    weights::save(&request.out, file).with_context(|| format!("cannot write {}", request.out.display()))?;
    evaluate(config, &net, &params, 24)
}

/// End-point error on held-out worlds, `pairs` of each kind.
pub fn evaluate(config: &PretrainConfig, net: &FlowNet, params: &ParamSet<f32>, pairs: usize) -> Result<Vec<EndPointError>> {
    let mut errors = Vec::new();
    for &preset in &config.presets {
        let one = PretrainConfig { presets: vec![preset], batch: pairs, ..config.clone() };
        let batch = Worlds::new(&one, Split::HeldOut)?.batch(0, false)?;
        let predicted = net.predict(params, &batch.first, &batch.second, Some(config.iterations));
        let zero = Tensor::zeros(predicted.shape());
        errors.push(EndPointError {
            preset: preset.to_string(),
            network: end_point_error(&predicted, &batch.truth, &batch.valid),
            zero: end_point_error(&zero, &batch.truth, &batch.valid),
            pairs,
        });
    }
    Ok(errors)
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

struct FlowBatch {
    first: Tensor<f32>,
    second: Tensor<f32>,
    truth: Tensor<f32>,
    valid: Tensor<f32>,
}

struct Worlds {
    datasets: Vec<SyntheticDataset>,
    batch: usize,
    seed: u64,
}

impl Worlds {
    fn new(config: &PretrainConfig, split: Split) -> Result<Self> {
        let kinds = WorldKinds {
            presets: &config.presets,
            size: (config.width, config.height),
            seed: config.seed,
            split,
            worlds: config.steps.max(1) * config.batch,
            frames: 4,
        };
        let datasets = kinds.open()?;
        Ok(Worlds { datasets, batch: config.batch, seed: config.seed })
    }

    /// Pairs of a step: each sample has its own world; mostly neighbouring frames, in either direction.
    fn batch(&self, step: usize, augment: bool) -> Result<FlowBatch> {
        let samples = par::map_indices(self.batch, |i| -> Result<_> {
            let index = step * self.batch + i;
            let mut rng = ChaCha8Rng::seed_from_u64(self.seed ^ 0x666c_6f77);
            rng.set_stream(index as u64);
            // Two samples share a world.
            let dataset = &self.datasets[index / 2 % self.datasets.len()];
            let (a, b) = if augment { FRAME_PAIRS[rng.random_range(0..FRAME_PAIRS.len())] } else { (index % 2, 1 - index % 2) };
            let world = index / 2 % dataset.sequence_count();
            let (first, second) = (dataset.frame(world, a)?, dataset.frame(world, b)?);
            let truth = dataset.pair_truth(world, a, b)?.context("rendered worlds know their flow")?;
            Ok(sample(&first, &second, &truth, augment.then_some(&mut rng)))
        });
        let samples = samples.into_iter().collect::<Result<Vec<_>>>()?;
        let cat = |k: usize| {
            let shape = samples[0][k].shape();
            let data: Vec<f32> = samples.iter().flat_map(|s| s[k].data().iter().copied()).collect();
            Tensor::from_vec(Shape::new(samples.len(), shape.c(), shape.h(), shape.w()), data)
        };
        Ok(FlowBatch { first: cat(0), second: cat(1), truth: cat(2), valid: cat(3) })
    }
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
        let jitter = crate::data::Jitter::draw(rng);
        let apart = rng.random::<f64>() < 0.2;
        let other = if apart { crate::data::Jitter::draw(rng) } else { jitter };
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
