//! The pose network: trained on single pictures that are moved by a made-up motion before a made-up depth. The stand-in for
//! encoders that have seen ImageNet.
//!
//! A picture is the source. A random depth, which has nothing to do with what the picture shows, and a random motion give the
//! flow of a rigid scene; the picture read along that flow is the target. Depth and motion are known because they were drawn:
//! no true depth and no true motion of any world, and no second frame, is used. The network learns to find what went where and
//! to say it as a motion; what depths and motions its frames really have it must learn later.
//!
//! Loss: mean difference, in pixels, of the rigid flows by the predicted and by the drawn motion, both before the drawn depth.

use anyhow::Result;
use dimode_autodiff::ops::bilinear_sample::SamplePadding;
use dimode_autodiff::{Shape, Tape, Tensor, Var};
use dimode_geometry::Intrinsics;
use dimode_geometry::taped::{self, RotationForm, masks};
use dimode_nets::{Binder, ParamSet, PoseNetKind};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::target::Form;
use super::task::Task;
use super::worlds::Worlds;
use crate::batch::join;
use crate::config::{NetsConfig, SCALE_ANCHOR};
use crate::data::{Dataset, Jitter};
use crate::losses::flow_consistency::flow_consistency;
use crate::model::{DepthRange, Model, stack};

/// A pose network that learns the motions by which single pictures were moved.
#[derive(Clone, Debug)]
pub struct PoseTask {
    model: Model,
}

impl PoseTask {
    /// A network of the given size.
    pub fn new(net: PoseNetKind) -> Self {
        PoseTask { model: Model::new(&NetsConfig { pose: net, ..NetsConfig::default() }) }
    }
}

/// Pairs made from single pictures, `[n, c, h, w]` each.
#[derive(Clone, Debug)]
pub struct PoseBatch {
    /// The pictures.
    pub source: Tensor<f32>,
    /// The pictures seen from the other place.
    pub target: Tensor<f32>,
    /// Depth of the targets.
    pub depth: Tensor<f32>,
    /// Flow from target to source, pixels.
    pub flow: Tensor<f32>,
    /// Where the flow ends inside the picture.
    pub mask: Tensor<f32>,
    /// Camera of each pair.
    pub cameras: Vec<Intrinsics>,
}

impl Task for PoseTask {
    type Batch = PoseBatch;

    const NETWORK: &'static str = "pose";
    const FORM: Form = Form::Folder(&["pose_encoder.safetensors", "pose.safetensors", "posenet.safetensors"]);
    const MEASURE: &'static str = "difference of flows";
    const BASELINE: &'static str = "no motion";
    const STREAM: u64 = 0x706f_7365;
    const STEPS: usize = 12_000;
    const BATCH: usize = 8;
    const LOOK_EVERY: usize = 500;
    const LOOK_PAIRS: usize = 16;
    const FINAL_PAIRS: usize = 96;

    fn init(&self, seed: u64) -> ParamSet<f32> {
        self.model.init(seed).pose
    }

    /// Pairs of a step; half of them are seen in either order, so that their number must be even.
    fn batch(&self, worlds: &Worlds, step: usize, pairs: usize) -> Result<PoseBatch> {
        let range = self.model.range;
        let samples = worlds.samples(step, pairs, |dataset, world, index, mut rng| {
            let frame = dataset.frame(world, 3 * (index % 2))?;
            let image = stack([&Jitter::draw(&mut rng).apply(&frame.image)]);
            let disparity = random_disparity(&mut rng, frame.image.width, frame.image.height);
            Ok((image, range.depth_values(&disparity), random_motion(&mut rng, range), frame.intrinsics))
        })?;
        let source = join(&samples.iter().map(|s| &s.0).collect::<Vec<_>>());
        let depth = join(&samples.iter().map(|s| &s.1).collect::<Vec<_>>());
        let cameras: Vec<Intrinsics> = samples.iter().map(|s| s.3).collect();
        let vectors = |k: usize| {
            let data = samples.iter().flat_map(|s| s.2[k]).collect();
            Tensor::from_vec(Shape::new(pairs, 3, 1, 1), data)
        };
        let tape = Tape::new();
        let [rotation, translation] = [0, 1].map(|k| tape.constant(vectors(k)));
        let pose = taped::source_from_target(rotation, translation, false, RotationForm::Exponential);
        let flow = taped::rigid_flow(tape.constant(depth.clone()), pose.rotation, pose.translation, &cameras).slice(1, 0, 2);
        let target = taped::warp(tape.constant(source.clone()), flow, SamplePadding::Border).value();
        let flow = flow.value();
        let mask = masks::in_view(&flow);
        Ok(PoseBatch { source, target, depth, flow, mask, cameras })
    }

    fn loss<'t>(&self, binder: &mut Binder<'t, f32>, batch: &PoseBatch) -> Var<'t, f32> {
        difference(&self.model, binder, batch)
    }

    /// Mean differences of the rigid flows by the network's motions, and by none, from the true ones.
    fn errors(&self, params: &ParamSet<f32>, batch: &PoseBatch) -> [f64; 2] {
        let tape = Tape::new();
        let network = difference(&self.model, &mut Binder::frozen(&tape, params), batch);
        let still = tape.constant(Tensor::zeros(batch.flow.shape()));
        [network, flow_consistency(still, &batch.flow, &batch.mask)].map(|error| error.value().item().into())
    }
}

/// Mean difference in pixels of the rigid flows by the network's motions and by the true ones.
fn difference<'t>(model: &Model, binder: &mut Binder<'t, f32>, pairs: &PoseBatch) -> Var<'t, f32> {
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
fn flow_difference<'t>(rotation: Var<'t, f32>, translation: Var<'t, f32>, pairs: &PoseBatch) -> Var<'t, f32> {
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
    use nalgebra::Vector3;
    use rand::SeedableRng;

    use super::*;
    use crate::data::synthetic::{Preset, Split};
    use crate::pretrain::Settings;

    fn range() -> DepthRange {
        task().model.range
    }

    fn task() -> PoseTask {
        PoseTask::new(PoseNetKind::Nano)
    }

    /// The pairs of a step of four.
    fn pairs(step: usize) -> PoseBatch {
        let settings = Settings { width: 64, height: 64, ..Settings::new(2, 4) };
        let worlds = Worlds::open::<PoseTask>(&settings, &[Preset::Handheld], Split::Train).unwrap();
        task().batch(&worlds, step, 4).unwrap()
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
        let pairs = pairs(0);
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
        let pairs = pairs(1);
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
