//! `l_geo`, and what SC-Depth's forms of `l_pho` share with it: the consistency of view pairs.
//!
//! Every target is paired with both sources, each pair in both directions. The motion back is the inverse of the motion there,
//! where the SC-Depth programs ask the pose network a second time.

use dimode_autodiff::{Tensor, Var};
use dimode_geometry::taped::{Pose, SampleGrid};

use super::needs::{FlowWays, Needs, SourceDepth};
use super::scene::Scene;
use super::term::{Term, TermKind};
use crate::config::{LossConfig, Photometric, StageConfig};
use crate::losses::sc_depth_pair::{self, MIN_PIXELS, PairLoss, PairMaps};
use crate::losses::sc_sfm_pair;
use crate::losses::view_pair::{COLOURS, View, ViewPair};

pub(super) const KIND: TermKind = TermKind { needs, measure };

/// What view pairs need.
pub(super) const NEEDS: Needs = Needs { source_depth: SourceDepth::Gradient, flow: FlowWays::None };

/// Where the reference is read.
const GRID: SampleGrid = SampleGrid::Pixels;

/// The consistency of all view pairs of a batch.
pub(super) struct ViewPairs<'l> {
    /// Photometric loss.
    pub photo: Var<'l, f32>,
    /// Relative difference of the depths.
    pub geometry: Var<'l, f32>,
    /// Share of the pixels that counted.
    pub valid: f64,
}

fn needs(loss: &LossConfig, _: &StageConfig) -> Needs {
    if loss.geometry_consistency > 0.0 { NEEDS } else { Needs::default() }
}

fn measure<'l>(scene: &Scene<'_, 'l>) -> Vec<Term<'l>> {
    let weight = scene.loss.geometry_consistency;
    if weight == 0.0 {
        return Vec::new();
    }
    let pairs = scene.view_pairs();
    vec![Term::new("l_geo", weight, pairs.geometry, pairs.valid)]
}

impl<'l> ViewPairs<'l> {
    pub fn new(scene: &Scene<'_, 'l>) -> Self {
        let (loss, candidates) = match scene.loss.photometric {
            Photometric::ScSfm => {
                let maps: Vec<_> = pairs(scene).iter().map(|pair| sc_sfm_pair::pair_maps(pair, GRID)).collect();
                (sc_sfm_pair::pair_loss(&maps, 3 * MIN_PIXELS), maps.len())
            }
            _ => (sc_depth_pair::pair_loss(scene.pair_maps(), MIN_PIXELS), 1),
        };
        let PairLoss { photo, geometry, pixels } = loss;
        let all = candidates * scene.samples() * scene.target_depth().shape().plane();
        ViewPairs { photo, geometry, valid: pixels as f64 / all as f64 }
    }
}

/// The maps of all pairs as sc_depth_pl has them.
pub(super) fn pair_maps<'l>(scene: &Scene<'_, 'l>) -> Vec<PairMaps<'l, f32>> {
    pairs(scene).iter().map(|pair| sc_depth_pair::pair_maps(pair, GRID)).collect()
}

/// How static each target pixel is, `[n, 1, h, w]`.
pub(super) fn static_weight(scene: &Scene<'_, '_>) -> Tensor<f32> {
    // Target to source stands before source to target.
    let to_sources: Vec<_> = scene.pair_maps().iter().step_by(2).cloned().collect();
    sc_depth_pair::static_weight(&to_sources)
}

/// Target and previous frame, the same exchanged, target and next frame, the same exchanged.
fn pairs<'a, 'l>(scene: &'a Scene<'_, 'l>) -> Vec<ViewPair<'a, 'l, f32>> {
    let (n, tape) = (scene.samples(), scene.tape());
    let [mean, deviation] = COLOURS;
    let colours = |image: Var<'l, f32>| image.add_scalar(-mean).scale(1.0 / deviation);
    let target = tape.constant(scene.batch.plain.target.clone());
    let target = View { image: colours(target), depth: scene.target_depth() };
    let sources = colours(scene.sources());
    let both_ways = (0..2).flat_map(|k| {
        let part = |x: Var<'l, f32>| x.slice(0, k * n, n);
        let motion = Pose { rotation: part(scene.motion().rotation), translation: part(scene.motion().translation) };
        let reference = View { image: part(sources), depth: part(scene.source_depth()) };
        let there = ViewPair { target, reference, motion, intrinsics: &scene.batch.intrinsics };
        [there, there.exchanged(motion.inverse())]
    });
    both_ways.collect()
}
