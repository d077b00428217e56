//! The pose network: trained on single pictures that are moved by a made-up motion before a made-up depth. The stand-in for
//! encoders that have seen ImageNet.
//!
//! A picture is the source. A random depth, which has nothing to do with what the picture shows, and a random motion give the
//! flow of a rigid scene; the picture read along that flow is the target. Depth and motion are known because they were drawn:
//! no true depth and no true motion of any world, and no second frame, is used. The network learns to find what went where and
//! to say it as a motion; what depths and motions its frames really have it must learn later.
//!
//! Loss: mean difference, in pixels, of the rigid flows by the predicted and by the drawn motion, both before the drawn depth.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result, bail};
use dimode_autodiff::ops::bilinear_sample::SamplePadding;
use dimode_autodiff::{Pool, Shape, Tape, Tensor, Var, par};
use dimode_geometry::Intrinsics;
use dimode_geometry::taped::{self, RotationForm, masks};
use dimode_nets::{Binder, Mode, ParamSet, PoseNetKind, weights};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{WorldKinds, step_all};
use crate::batch::join;
use crate::config::{NetsConfig, SCALE_ANCHOR};
use crate::data::synthetic::{Preset, Split, SyntheticDataset};
use crate::data::{Dataset, Jitter};
use crate::losses::flow_consistency::flow_consistency;
use crate::model::{DepthRange, Model, stack};
use crate::optim::adamw::{AdamW, State};
use crate::optim::schedule::{Decay, learning_rate};
use crate::progress::Progress;

/// Settings of the pre-training.
#[derive(Clone, Debug, PartialEq)]
pub struct PosePretraining {
    /// Size of the network.
    pub pose: PoseNetKind,
    /// Kinds of worlds that pictures are taken from, in turn.
    pub presets: Vec<Preset>,
    /// Picture width in pixels.
    pub width: usize,
    /// Picture height in pixels.
    pub height: usize,
    /// Training steps.
    pub steps: usize,
    /// Pairs in a batch; even, as half of them are seen in either order.
    pub batch: usize,
    /// Peak learning rate.
    pub learning_rate: f64,
    /// Steps of linear warm-up.
    pub warmup: usize,
    /// Seed of weights, pictures, depths and motions.
    pub seed: u64,
}

impl Default for PosePretraining {
    fn default() -> Self {
        PosePretraining {
            pose: PoseNetKind::Nano,
            presets: vec![Preset::Street, Preset::Handheld, Preset::Lateral],
            width: 128,
            height: 64,
            steps: 12_000,
            batch: 8,
            learning_rate: 1e-3,
            warmup: 200,
            seed: 1,
        }
    }
}

/// Mean difference of rigid flows on pictures of held-out worlds of one kind, in pixels.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct MotionError {
    /// Kind of worlds.
    pub preset: String,
    /// By the network's motion.
    pub network: f64,
    /// By no motion.
    pub zero: f64,
    /// Pairs measured.
    pub pairs: usize,
}

/// Trains the pose network and writes its files into the folder `out`; returns the error on held-out worlds.
///
/// # Errors
/// When interrupted, when the loss becomes non-finite, or when a file cannot be written.
pub fn train(config: &PosePretraining, out: &Path, progress: &dyn Progress, stop: &AtomicBool) -> Result<Vec<MotionError>> {
    par::inside(|| run(config, out, progress, stop))
}

fn run(config: &PosePretraining, out: &Path, progress: &dyn Progress, stop: &AtomicBool) -> Result<Vec<MotionError>> {
    let model = model(config);
    let mut params = model.init(config.seed).pose;
    let pictures = Pictures::new(config, &config.presets, Split::Train)?;
    let optimiser = AdamW { weight_decay: 1e-4, ..AdamW::default() };
    let mut state = State::default();
    let pool = Pool::new();
    progress.start(config.steps as u64, "pre-training pose");
    for step in 0..config.steps {
        if stop.load(Ordering::Relaxed) {
            bail!("interrupted at step {step}; nothing was written");
        }
        let pairs = pictures.moved(step, config.batch, model.range)?;
        let tape = Tape::with_pool(pool.clone());
        let mut binder = Binder::new(&tape, &params, Mode::Train);
        let loss = difference(&model, &mut binder, &pairs);
        let value = f64::from(loss.value().item());
        if !value.is_finite() {
            bail!("pre-training pose: the loss became {value} at step {step}; lower the learning rate");
        }
        let gradients = binder.gradients(&tape.backward_and_free(loss));
        let statistics = binder.into_statistics();
        let rate = learning_rate(config.learning_rate, step, config.steps, config.warmup, Decay::Cosine { final_fraction: 0.01 });
        step_all(&optimiser, &mut state, &mut params, gradients, rate);
        params.apply_statistics(&statistics);
        progress.step(step as u64 + 1, &format!("loss {value:.3}"));
        if (step + 1) % 500 == 0 {
            let errors = evaluate(config, &model, &params, 16)?;
            let text: Vec<_> = errors.iter().map(|e| format!("{} {:.3} px", e.preset, e.network)).collect();
            progress.note(&format!("step {}: difference {}", step + 1, text.join(", ")));
        }
    }
    progress.finish();
    weights::save_directory(out, &params).with_context(|| format!("cannot write {}", out.display()))?;
    evaluate(config, &model, &params, 96)
}

fn model(config: &PosePretraining) -> Model {
    Model::new(&NetsConfig { pose: config.pose, ..NetsConfig::default() })
}

/// Differences on pictures of held-out worlds, `pairs` of each kind.
///
/// # Errors
/// When a picture cannot be rendered.
pub fn evaluate(config: &PosePretraining, model: &Model, params: &ParamSet<f32>, pairs: usize) -> Result<Vec<MotionError>> {
    let mut errors = Vec::new();
    for preset in &config.presets {
        let moved = Pictures::new(config, std::slice::from_ref(preset), Split::HeldOut)?.moved(0, pairs, model.range)?;
        let tape = Tape::new();
        let network = difference(model, &mut Binder::frozen(&tape, params), &moved).value().item();
        let still = tape.constant(Tensor::zeros(moved.flow.shape()));
        let zero = flow_consistency(still, &moved.flow, &moved.mask).value().item();
        errors.push(MotionError { preset: preset.to_string(), network: network.into(), zero: zero.into(), pairs });
    }
    Ok(errors)
}

/// Mean difference in pixels of the rigid flows by the network's motions and by the true ones.
fn difference<'t>(model: &Model, binder: &mut Binder<'t, f32>, pairs: &Moved) -> Var<'t, f32> {
    let tape = binder.tape();
    let (n, half) = (pairs.cameras.len(), pairs.cameras.len() / 2);
    let part = |x: &Tensor<f32>, from: usize, len: usize| tape.constant(x.clone()).slice(0, from, len).value();
    // The first half is seen target first, the second half source first; the network says the second frame from the first.
    let first = join(&[&part(&pairs.target, 0, half), &part(&pairs.source, half, n - half)]);
    let second = join(&[&part(&pairs.source, 0, half), &part(&pairs.target, half, n - half)]);
    let [rotation, translation] = model.motion(binder, tape.constant(first), tape.constant(second));
    flow_difference(rotation, translation, pairs)
}

/// Mean difference in pixels of the rigid flow by given motions and the true flow. Motions say the second frame from the first:
/// source from target in the first half of the pairs, target from source in the second.
fn flow_difference<'t>(rotation: Var<'t, f32>, translation: Var<'t, f32>, pairs: &Moved) -> Var<'t, f32> {
    let tape = rotation.tape();
    let (n, half) = (pairs.cameras.len(), pairs.cameras.len() / 2);
    let pose = |from, len, invert| {
        let (rotation, translation) = (rotation.slice(0, from, len), translation.slice(0, from, len));
        taped::source_from_target(rotation, translation, invert, RotationForm::Exponential)
    };
    let (forwards, backwards) = (pose(0, half, false), pose(half, n - half, true));
    let rotation = Var::concat(&[forwards.rotation, backwards.rotation], 0);
    let translation = Var::concat(&[forwards.translation, backwards.translation], 0);
    let rigid = taped::rigid_flow(tape.constant(pairs.depth.clone()), rotation, translation, &pairs.cameras);
    flow_consistency(rigid.slice(1, 0, 2), &pairs.flow, &pairs.mask)
}

/// Pairs made from single pictures, `[n, c, h, w]` each.
struct Moved {
    /// The pictures.
    source: Tensor<f32>,
    /// The pictures seen from the other place.
    target: Tensor<f32>,
    /// Depth of the targets.
    depth: Tensor<f32>,
    /// Flow from target to source, pixels.
    flow: Tensor<f32>,
    /// Where the flow ends inside the picture.
    mask: Tensor<f32>,
    cameras: Vec<Intrinsics>,
}

/// Where pictures come from.
struct Pictures {
    kinds: Vec<SyntheticDataset>,
    seed: u64,
}

impl Pictures {
    fn new(config: &PosePretraining, presets: &[Preset], split: Split) -> Result<Self> {
        let size = (config.width, config.height);
        let worlds = config.steps.max(1) * config.batch.max(96);
        let kinds = WorldKinds { presets, size, seed: config.seed, split, worlds, frames: 4 }.open()?;
        Ok(Pictures { kinds, seed: config.seed })
    }

    /// Pairs of a step. Two samples share a world.
    fn moved(&self, step: usize, batch: usize, range: DepthRange) -> Result<Moved> {
        let samples = par::map_indices(batch, |i| -> Result<_> {
            let index = step * batch + i;
            let mut rng = ChaCha8Rng::seed_from_u64(self.seed ^ 0x706f_7365);
            rng.set_stream(index as u64);
            let kind = &self.kinds[index / 2 % self.kinds.len()];
            let frame = kind.frame(index / 2 % kind.sequence_count(), 3 * (index % 2))?;
            let image = stack([&Jitter::draw(&mut rng).apply(&frame.image)]);
            let disparity = random_disparity(&mut rng, frame.image.width, frame.image.height);
            Ok((image, range.depth_values(&disparity), random_motion(&mut rng, range), frame.intrinsics))
        });
        let samples = samples.into_iter().collect::<Result<Vec<_>>>()?;
        let source = join(&samples.iter().map(|s| &s.0).collect::<Vec<_>>());
        let depth = join(&samples.iter().map(|s| &s.1).collect::<Vec<_>>());
        let cameras: Vec<Intrinsics> = samples.iter().map(|s| s.3).collect();
        let vectors = |k: usize| {
            let data = samples.iter().flat_map(|s| s.2[k]).collect();
            Tensor::from_vec(Shape::new(batch, 3, 1, 1), data)
        };
        let tape = Tape::new();
        let [rotation, translation] = [0, 1].map(|k| tape.constant(vectors(k)));
        let pose = taped::source_from_target(rotation, translation, false, RotationForm::Exponential);
        let flow = taped::rigid_flow(tape.constant(depth.clone()), pose.rotation, pose.translation, &cameras).slice(1, 0, 2);
        let target = taped::warp(tape.constant(source.clone()), flow, SamplePadding::Border).value();
        let flow = flow.value();
        let mask = masks::in_view(&flow);
        Ok(Moved { source, target, depth, flow, mask, cameras })
    }
}

/// Uniform in `[lo, hi)`.
fn between(rng: &mut ChaCha8Rng, lo: f64, hi: f64) -> f64 {
    lo + (hi - lo) * rng.random::<f64>()
}

/// A random disparity map `[1, 1, h, w]` with the mean that training holds: a slope, waves, perhaps ground below a horizon, and
/// boxes that stand out.
fn random_disparity(rng: &mut ChaCha8Rng, width: usize, height: usize) -> Tensor<f32> {
    let slope = [between(rng, -0.6, 0.6), between(rng, -0.6, 0.6)];
    let waves: Vec<[f64; 4]> = (0..4)
        .map(|_| [between(rng, -6.0, 6.0), between(rng, -6.0, 6.0), between(rng, 0.0, 6.3), between(rng, 0.0, 0.3)])
        .collect();
    let ground = if rng.random::<f64>() < 0.5 { between(rng, 0.5, 2.0) } else { 0.0 };
    let horizon = between(rng, -0.4, 0.4);
    let boxes: Vec<[f64; 5]> = (0..rng.random_range(0..9))
        .map(|_| {
            let (x, y) = (between(rng, -1.0, 1.0), between(rng, -1.0, 1.0));
            [x, y, between(rng, 0.05, 0.5), between(rng, 0.05, 0.6), between(rng, -0.8, 1.2)]
        })
        .collect();
    let at = |u: usize, v: usize| {
        let x = 2.0 * u as f64 / (width.max(2) - 1) as f64 - 1.0;
        let y = 2.0 * v as f64 / (height.max(2) - 1) as f64 - 1.0;
        let wavy: f64 = waves.iter().map(|[kx, ky, phase, size]| size * (kx * x + ky * y + phase).sin()).sum();
        let standing: f64 = boxes.iter().filter(|b| (x - b[0]).abs() < b[2] && (y - b[1]).abs() < b[3]).map(|b| b[4]).sum();
        (slope[0] * x + slope[1] * y + wavy + ground * (y - horizon).max(0.0) + standing.clamp(-1.5, 1.5)).exp()
    };
    let values: Vec<f64> = (0..width * height).map(|i| at(i % width, i / width)).collect();
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let data = values.iter().map(|d| (SCALE_ANCHOR * d / mean).clamp(0.004, 0.95) as f32).collect();
    Tensor::from_vec(Shape::new(1, 1, height, width), data)
}

/// Rotation vector of 0.1 to 6 degrees, radians, and a translation of 0.5 to 12 % of the depth at mean disparity; half of the
/// translations go forwards or backwards, the others anywhere.
fn random_motion(rng: &mut ChaCha8Rng, range: DepthRange) -> [[f32; 3]; 2] {
    let log_uniform = |rng: &mut ChaCha8Rng, lo: f64, hi: f64| between(rng, lo.ln(), hi.ln()).exp();
    let (angle, length) = (log_uniform(rng, 0.1, 6.0).to_radians(), range.usual() * log_uniform(rng, 0.005, 0.12));
    let axis = unit_vector(rng, 1.0);
    let tangential = if rng.random::<f64>() < 0.5 { 0.15 } else { 1.0 };
    let direction = unit_vector(rng, tangential);
    [axis.map(|x| (angle * x) as f32), direction.map(|x| (length * x) as f32)]
}

/// A direction; x and y are squeezed by a factor before it is made a unit vector.
fn unit_vector(rng: &mut ChaCha8Rng, tangential: f64) -> [f64; 3] {
    loop {
        let mut v = [0; 3].map(|_| between(rng, -1.0, 1.0));
        let length = |v: &[f64; 3]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
        if (0.1..=1.0).contains(&length(&v)) {
            v[0] *= tangential;
            v[1] *= tangential;
            let size = length(&v);
            if size > 1e-3 {
                return v.map(|x| x / size);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn config() -> PosePretraining {
        PosePretraining { presets: vec![Preset::Handheld], width: 64, height: 64, steps: 2, batch: 4, ..Default::default() }
    }

    fn range() -> DepthRange {
        model(&config()).range
    }

    #[test]
    fn depths_keep_the_mean_of_training_and_stay_in_range() {
        for seed in 0..20 {
            let disparity = random_disparity(&mut ChaCha8Rng::seed_from_u64(seed), 32, 16);
            let mean = disparity.data().iter().sum::<f32>() / 512.0;
            assert!((mean - 0.2).abs() < 0.02, "seed {seed}: {mean}");
            assert!(disparity.data().iter().all(|d| (0.004..=0.95).contains(d)), "seed {seed}");
        }
    }

    #[test]
    fn motions_stay_within_their_bounds() {
        let depth = range().usual();
        let norm = |v: &[f32; 3]| Vector3::from(v.map(f64::from)).norm();
        let mut forwards = 0;
        for seed in 0..200 {
            let [rotation, translation] = random_motion(&mut ChaCha8Rng::seed_from_u64(seed), range());
            assert!((0.1..6.0).contains(&(norm(&rotation).to_degrees() + 1e-6)), "{rotation:?}");
            assert!((0.005..0.12).contains(&(norm(&translation) / depth + 1e-6)), "{translation:?}");
            forwards += usize::from(f64::from(translation[2].abs()) > 0.9 * norm(&translation));
        }
        assert!((70..150).contains(&forwards), "{forwards} of 200 along the optical axis");
    }

    /// The drawn motions, as the network would have to say them, leave nothing; others do.
    #[test]
    fn true_motions_cost_nothing_in_either_order() {
        let pictures = Pictures::new(&config(), &[Preset::Handheld], Split::Train).unwrap();
        let pairs = pictures.moved(0, 4, range()).unwrap();
        let said = |wrong: f64| {
            let mut said = [Vec::new(), Vec::new()];
            for i in 0..4 {
                let mut rng = ChaCha8Rng::seed_from_u64(1 ^ 0x706f_7365);
                rng.set_stream(i as u64);
                Jitter::draw(&mut rng);
                random_disparity(&mut rng, 64, 64);
                let [w, t] = random_motion(&mut rng, range()).map(|v| Vector3::from(v.map(f64::from)));
                let source_from_target = dimode_geometry::Se3::from_rotation_vector(&w, t);
                let second_from_first = if i < 2 { source_from_target } else { source_from_target.inverse() };
                let log = dimode_geometry::so3::log(&second_from_first.rotation);
                said[0].extend(log.iter().map(|x| (x * wrong) as f32));
                said[1].extend(second_from_first.translation.iter().map(|x| *x as f32));
            }
            let tape = Tape::new();
            let [w, t] = said.map(|v| tape.constant(Tensor::from_vec(Shape::new(4, 3, 1, 1), v)));
            flow_difference(w, t, &pairs).value().item()
        };
        assert!(said(1.0) < 1e-3, "{}", said(1.0));
        assert!(said(1.1) > 1e-2, "{}", said(1.1));
    }

    /// Reading the target at the place where a source pixel came from gives that source pixel again.
    #[test]
    fn targets_are_the_pictures_moved_by_the_flow() {
        let pictures = Pictures::new(&config(), &[Preset::Handheld], Split::Train).unwrap();
        let pairs = pictures.moved(1, 4, range()).unwrap();
        let shape = pairs.source.shape();
        for n in 0..4 {
            for i in (0..shape.plane()).step_by(97).filter(|&i| pairs.mask.plane(n, 0)[i] > 0.0) {
                let x = (i % shape.w()) as f32 + pairs.flow.plane(n, 0)[i];
                let y = (i / shape.w()) as f32 + pairs.flow.plane(n, 1)[i];
                let (u, v) = ((x as usize).min(shape.w() - 2), (y as usize).min(shape.h() - 2));
                let (a, b) = (x - u as f32, y - v as f32);
                let at = |du: usize, dv: usize| pairs.source.at(n, 1, v + dv, u + du);
                let read = (1.0 - b) * ((1.0 - a) * at(0, 0) + a * at(1, 0)) + b * ((1.0 - a) * at(0, 1) + a * at(1, 1));
                assert!((read - pairs.target.plane(n, 1)[i]).abs() < 1e-4, "sample {n}, pixel {i}");
            }
        }
    }
}
