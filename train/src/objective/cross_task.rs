//! `cross_task`: rigid and optical flow agree in both directions, on every scale (DF-Net).

use dimode_autodiff::Var;
use dimode_geometry::Intrinsics;
use dimode_geometry::taped::{Pose, rigid_flow};

use super::needs::{FlowWays, Needs, SourceDepth};
use super::scene::{Scene, share, twice};
use super::term::{Term, TermKind};
use crate::config::{LossConfig, StageConfig};
use crate::losses::cross_task::{FlowPair, cross_task_of_scales, mutual_mask};

pub(super) const KIND: TermKind = TermKind { needs, measure };

fn needs(_: &LossConfig, stage: &StageConfig) -> Needs {
    if stage.cross_task == 0.0 {
        return Needs::default();
    }
    Needs { source_depth: SourceDepth::Gradient, flow: FlowWays::Both }
}

fn measure<'l>(scene: &Scene<'_, 'l>) -> Vec<Term<'l>> {
    let weight = scene.stage.cross_task;
    if weight == 0.0 {
        return Vec::new();
    }
    let n = scene.samples();
    let scales: Vec<_> = (0..scene.leaves.disparities.len()).map(|scale| flows(scene, scale)).collect();
    let of_source = |k: usize| -> Vec<_> { scales.iter().map(|flows| part(flows, k * n, n)).collect() };
    let value = cross_task_of_scales(&of_source(0)).add(cross_task_of_scales(&of_source(1)));
    vec![Term::new("cross_task", weight, value, share(&mutual_mask(&scales[0])))]
}

/// All four flows of a scale, at its size and in its pixels.
fn flows<'l>(scene: &Scene<'_, 'l>, scale: usize) -> FlowPair<'l, f32> {
    let disparity = scene.leaves.disparities[scale];
    let (height, width) = (disparity.shape().h(), disparity.shape().w());
    let cameras: Vec<_> = scene.cameras.iter().map(|camera| camera.resized(width, height)).collect();
    let source = scene.range.depth(scene.leaves.source_disparities[scale]);
    let optical = scene.flow();
    FlowPair {
        rigid: rigid(twice(scene.range.depth(disparity)), scene.motion(), &cameras),
        optical: resized(optical.forward, height, width),
        rigid_back: rigid(source, scene.motion().inverse(), &cameras),
        optical_back: resized(optical.backward.expect("this term needs both ways"), height, width),
    }
}

fn rigid<'l>(depth: Var<'l, f32>, motion: Pose<'l, f32>, cameras: &[Intrinsics]) -> Var<'l, f32> {
    rigid_flow(depth, motion.rotation, motion.translation, cameras).slice(1, 0, 2)
}

/// A flow at another size, in pixels of that size.
fn resized(flow: Var<'_, f32>, height: usize, width: usize) -> Var<'_, f32> {
    let s = flow.shape();
    if (s.h(), s.w()) == (height, width) {
        return flow;
    }
    let small = flow.resize_bilinear(height, width, false);
    let axis = |c: usize, factor: f64| small.slice(1, c, 1).scale(factor);
    Var::concat(&[axis(0, width as f64 / s.w() as f64), axis(1, height as f64 / s.h() as f64)], 1)
}

/// The samples from `start` on.
fn part<'l>(flows: &FlowPair<'l, f32>, start: usize, len: usize) -> FlowPair<'l, f32> {
    let cut = |x: Var<'l, f32>| x.slice(0, start, len);
    FlowPair {
        rigid: cut(flows.rigid),
        optical: cut(flows.optical),
        rigid_back: cut(flows.rigid_back),
        optical_back: cut(flows.optical_back),
    }
}
