//! What the terms say of rendered worlds whose truth stands in for the networks, and of anything beside the functions they are made
//! of.

use dimode_autodiff::gradcheck::random;
use dimode_autodiff::{Pool, Shape, Tape, Tensor, Var};
use dimode_geometry::taped::SampleGrid;
use dimode_geometry::taped::pose::pose_tensors;
use dimode_geometry::{Se3, losses::LossOptions};

use super::*;
use crate::batch::join;
use crate::config::{ContextualDepth, LossPreset, Occlusion, Photometric, Preset, Sources};
use crate::data::Dataset;
use crate::losses::multi_scale::{MultiScale, Reprojection, SMOOTHNESS, multi_scale};
use crate::losses::sc_depth_pair::{MIN_PIXELS, pair_loss, pair_maps};
use crate::losses::view_pair::{COLOURS, View, ViewPair};
use crate::run::training_frames;
use crate::teacher::Teacher;

/// A batch of two snippets of rendered worlds.
struct Truth {
    config: Config,
    frames: Box<dyn Dataset>,
    batch: Batch,
}

/// Depths up to which disparities of the truth stay in (0, 1), metres.
const RANGE: DepthRange = DepthRange { min: 0.2, max: 1e4 };
const SNIPPETS: [(usize, usize); 2] = [(0, 1), (1, 2)];

impl Truth {
    fn new(preset: LossPreset, world: Preset) -> Self {
        let mut config = preset.config();
        (config.data.preset, config.data.worlds, config.data.frames) = (world, 2, 4);
        (config.train.flip, config.train.jitter) = (false, false);
        let frames = training_frames(&config).unwrap();
        let batch = Batch::load(frames.as_ref(), &SNIPPETS, (&config.train, &Teacher::None), 1, 0, &dimode_autodiff::Pool::new())
            .unwrap();
        Truth { config, frames, batch }
    }

    /// Frames of both snippets: `offset` 0 for the targets, -1 and 1 for the sources.
    fn disparity(&self, offset: isize) -> Tensor<f32> {
        let maps = SNIPPETS.map(|(sequence, target)| {
            let frame = self.frames.frame(sequence, target.wrapping_add_signed(offset)).unwrap();
            let depth = frame.depth.as_ref().unwrap();
            let scale = 1.0 / RANGE.min - 1.0 / RANGE.max;
            // The sky has no depth and is as far as can be.
            let disparity = |z: f32| if z > 0.0 { ((1.0 / f64::from(z) - 1.0 / RANGE.max) / scale) as f32 } else { 0.0 };
            Tensor::from_vec(Shape::new(1, 1, depth.height, depth.width), depth.data.iter().map(|&z| disparity(z)).collect())
        });
        join(&[&maps[0], &maps[1]])
    }

    /// Motion and flow from the targets to the sources at an offset, and the flow back.
    fn pairs(&self, offset: isize) -> ([Se3; 2], [Tensor<f32>; 2]) {
        let pair = |(sequence, target): (usize, usize), back: bool| {
            let source = target.wrapping_add_signed(offset);
            let (from, to) = if back { (source, target) } else { (target, source) };
            self.frames.pair_truth(sequence, from, to).unwrap().unwrap()
        };
        let flow = |back| {
            let maps = SNIPPETS.map(|snippet| {
                let flow = pair(snippet, back).flow;
                let data = flow.u.iter().chain(&flow.v).copied().collect();
                Tensor::from_vec(Shape::new(1, 2, flow.height, flow.width), data)
            });
            join(&[&maps[0], &maps[1]])
        };
        (SNIPPETS.map(|snippet| pair(snippet, false).source_from_target), [flow(false), flow(true)])
    }

    /// The truth as outputs of networks; with `exchanged` the flows of the two sources stand in each other's place.
    fn outputs<'t>(&self, tape: &'t Tape<f32>, exchanged: bool) -> Outputs<'t> {
        let [(before, flow_before), (after, flow_after)] = [-1, 1].map(|offset| self.pairs(offset));
        let (rotation, translation) = pose_tensors(&[before, after].concat());
        let flow = |k: usize| {
            let parts = if exchanged { [&flow_after[k], &flow_before[k]] } else { [&flow_before[k], &flow_after[k]] };
            tape.constant(join(&parts))
        };
        let sources = tape.leaf(join(&[&self.disparity(-1), &self.disparity(1)]));
        let scales = |map: Var<'t, f32>| -> Vec<Var<'t, f32>> {
            let s = map.shape();
            let size = |scale: usize| (s.h() >> scale, s.w() >> scale);
            (0..self.config.loss.scales)
                .map(|k| if k == 0 { map } else { map.resize_bilinear(size(k).0, size(k).1, false) })
                .collect()
        };
        Outputs {
            disparities: scales(tape.leaf(self.disparity(0))),
            source_disparities: scales(sources),
            motion: dimode_geometry::taped::Pose { rotation: tape.leaf(rotation), translation: tape.leaf(translation) },
            flow: Some(Flow { forward: flow(0), backward: Some(flow(1)), trained: false }),
            rectified: None,
        }
    }

    fn report(&self, outputs: &Outputs<'_>, stage: &StageConfig) -> LossReport {
        let given = Given { batch: &self.batch, stage, step: 3, probe: false };
        measure(&self.config, RANGE, &Pool::new(), outputs, &given).unwrap().0
    }
}

fn value(report: &LossReport, name: &str) -> f64 {
    report.terms.iter().find(|term| term.name == name).unwrap_or_else(|| panic!("no {name} in {report:?}")).value
}

/// A stage with every term that compares with flow.
fn all_terms() -> StageConfig {
    let lambdas = StageConfig { lambda1: 0.05, lambda2: 0.1, ..StageConfig::new("all", 1.0) };
    StageConfig { cross_task: 1.0, contextual: 1.0, rigid: 1.0, divergence: 1.0, ..lambdas }
}

/// Every term that compares depth, motion and flow is small at the truth, and large where the two sources' flows are exchanged: so
/// sources stand in one order everywhere, motions lead the way they should, and flows are in pixels of their scale.
#[test]
fn the_truth_of_a_rendered_world_costs_little_and_an_exchange_of_sources_much() {
    for world in [Preset::Street, Preset::Handheld] {
        let mut truth = Truth::new(LossPreset::Dimode, world);
        truth.config.loss.geometric =
            LossOptions { noise_pixels: 0.0, noise_share: 0.0, min_tangential_share: 0.0, ..LossOptions::default() };
        truth.config.loss.geometry_consistency = 0.1;
        truth.config.loss.scales = 2;
        truth.config.loss.flow_consistency = 1.0;
        // The radial depth is exact for motions along the axis only.
        let sideways = world == Preset::Handheld;
        truth.config.loss.contextual_depth = if sideways { ContextualDepth::Triangulated } else { ContextualDepth::Radial };
        for choice in [(Occlusion::ForwardBackward, Sources::Both), (Occlusion::RangeMap, Sources::Next)] {
            (truth.config.loss.occlusion, truth.config.loss.sources) = choice;
            let tape = Tape::new();
            let [true_flow, exchanged] =
                [false, true].map(|exchanged| truth.report(&truth.outputs(&tape, exchanged), &all_terms()));
            println!("{world} {choice:?}");
            for (name, most, times) in [
                ("flow_consistency", 0.02, 20.0),
                ("l_pla", 0.05, 10.0),
                ("l_axi", 0.05, 10.0),
                ("l_tan", 0.05, 10.0),
                ("l_rad", 0.05, 10.0),
                // Without a static mask the sky counts, whose true flow is not known: 6.35 times 0.06 px, four times.
                ("cross_task", 3.0, 10.0),
                // Its gate drops what is far off.
                ("contextual", 0.6, 1.5),
                ("rigid", 0.1, 2.0),
            ] {
                let [at_truth, apart] = [&true_flow, &exchanged].map(|report| value(report, name));
                println!("  {name}: {at_truth:.2e} at the truth, {apart:.2e} exchanged");
                assert!(at_truth < most && apart > times * at_truth, "{world} {choice:?} {name}: {at_truth} and {apart}");
            }
            let geometry = value(&true_flow, "l_geo");
            assert!(geometry < 0.03, "{world}: l_geo {geometry}");
        }
    }
}

/// The total of Monodepth2 that is compared with the reference numbers.
#[test]
fn the_photometric_terms_add_up_to_the_total_of_several_scales() {
    let mut truth = Truth::new(LossPreset::Monodepth2, Preset::Handheld);
    truth.config.loss.auto_mask = false;
    let tape = Tape::new();
    let mut outputs = truth.outputs(&tape, false);
    outputs.disparities[0] = tape.leaf(random(5, outputs.disparities[0].shape(), 0.1, 0.9));
    let report = truth.report(&outputs, &truth.config.train.stages[0].clone());
    let n = SNIPPETS.len();
    let motion = |k: usize| dimode_geometry::taped::Pose {
        rotation: outputs.motion.rotation.slice(0, k * n, n),
        translation: outputs.motion.translation.slice(0, k * n, n),
    };
    let plain = &truth.batch.plain;
    let target =
        |d: &Var<'_, f32>| tape.constant(plain.target.clone()).resize_bilinear(d.shape().h(), d.shape().w(), false).value();
    let whole = multi_scale(&MultiScale {
        disparities: &outputs.disparities,
        range: RANGE,
        targets: &outputs.disparities.iter().map(target).collect::<Vec<_>>(),
        sources: &[plain.previous.clone(), plain.next.clone()],
        motions: &[motion(0), motion(1)],
        intrinsics: &truth.batch.intrinsics,
        identities: &[],
        smoothness: SMOOTHNESS,
        reprojection: Reprojection::RigidFlow,
    });
    let expected = f64::from(whole.total.value().item());
    let found = value(&report, "l_pho") + truth.config.loss.smoothness * value(&report, "smooth");
    assert_eq!(outputs.disparities.len(), 4);
    assert!((found - expected).abs() < 1e-6 * expected, "{found} instead of {expected}");
}

/// The pair terms that are compared with the reference numbers, each source by itself.
#[test]
fn the_terms_of_view_pairs_are_those_of_all_pairs_in_both_directions() {
    let truth = Truth::new(LossPreset::ScDepth, Preset::Street);
    assert_eq!(truth.config.loss.photometric, Photometric::ScDepth);
    let tape = Tape::new();
    let outputs = truth.outputs(&tape, false);
    let report = truth.report(&outputs, &truth.config.train.stages[0].clone());
    let plain = &truth.batch.plain;
    let colours = |image: &Tensor<f32>| tape.constant(image.clone()).add_scalar(-COLOURS[0]).scale(1.0 / COLOURS[1]);
    let view =
        |image: &Tensor<f32>, offset| View { image: colours(image), depth: RANGE.depth(tape.constant(truth.disparity(offset))) };
    let maps = [(-1, &plain.previous), (1, &plain.next)].map(|(offset, image)| {
        let (rotation, translation) = pose_tensors(&truth.pairs(offset).0);
        let motion = dimode_geometry::taped::Pose { rotation: tape.constant(rotation), translation: tape.constant(translation) };
        let (target, reference) = (view(&plain.target, 0), view(image, offset));
        let there = ViewPair { target, reference, motion, intrinsics: &truth.batch.intrinsics };
        [there, there.exchanged(motion.inverse())].map(|pair| pair_maps(&pair, SampleGrid::Pixels))
    });
    let expected = pair_loss(&maps.concat(), MIN_PIXELS);
    for (name, expected) in [("l_pho", expected.photo), ("l_geo", expected.geometry)] {
        let (found, expected) = (value(&report, name), f64::from(expected.value().item()));
        assert!((found - expected).abs() < 1e-6 * expected, "{name}: {found} instead of {expected}");
    }
}

#[test]
fn the_next_frame_alone_counts_where_the_settings_say_so() {
    let mut truth = Truth::new(LossPreset::Dcpi, Preset::Handheld);
    truth.config.loss.contextual_depth = ContextualDepth::Triangulated;
    let stage = all_terms();
    let tape = Tape::new();
    let (clean, noisy) = (truth.report(&truth.outputs(&tape, false), &stage), truth.report(&spoilt(&truth, &tape), &stage));
    for name in ["l_axi", "l_tan", "l_rad", "contextual", "rigid"] {
        assert_eq!(value(&clean, name), value(&noisy, name), "{name}");
    }
    assert_ne!(value(&clean, "cross_task"), value(&noisy, "cross_task"));
    truth.config.loss.sources = Sources::Both;
    let (clean, noisy) = (truth.report(&truth.outputs(&tape, false), &stage), truth.report(&spoilt(&truth, &tape), &stage));
    for name in ["l_axi", "l_tan", "l_rad", "contextual", "rigid"] {
        assert!(value(&noisy, name) > value(&clean, name), "{name}");
    }
}

/// The truth with noise in the flow to the previous frames.
fn spoilt<'t>(truth: &Truth, tape: &'t Tape<f32>) -> Outputs<'t> {
    let mut outputs = truth.outputs(tape, false);
    let mut flow = outputs.flow.expect("the truth knows the flow");
    // The first half are the previous frames.
    let noise = random::<f32>(8, flow.forward.shape(), -3.0, 3.0);
    let first = noise.shape().len() / 2;
    let clean = flow.forward.value();
    let data = clean.data().iter().zip(noise.data()).enumerate();
    let data = data.map(|(i, (f, n))| if i < first { f + n } else { *f }).collect();
    flow.forward = tape.constant(Tensor::from_vec(noise.shape(), data));
    outputs.flow = Some(flow);
    outputs
}
