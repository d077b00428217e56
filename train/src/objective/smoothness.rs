//! `smooth`: edge-aware smoothness of disparity or depth, halved at each coarser scale, mean over scales.

use dimode_autodiff::{Tensor, Var};

use super::needs::{Needs, SourceDepth};
use super::scene::Scene;
use super::term::{Term, TermKind};
use crate::config::{LossConfig, Photometric, SmoothnessOf, StageConfig};
use crate::losses::smoothness::normalised_edge_aware;
use crate::losses::view_pair::COLOURS;

pub(super) const KIND: TermKind = TermKind { needs, measure };

/// The first SC-Depth program smooths all frames, the others the target only.
fn needs(loss: &LossConfig, _: &StageConfig) -> Needs {
    let all_frames = loss.smoothness > 0.0 && loss.photometric == Photometric::ScSfm;
    let source_depth = if all_frames { SourceDepth::Gradient } else { SourceDepth::None };
    Needs { source_depth, ..Needs::default() }
}

fn measure<'l>(scene: &Scene<'_, 'l>) -> Vec<Term<'l>> {
    let weight = scene.loss.smoothness;
    if weight == 0.0 {
        return Vec::new();
    }
    let target = of_scales(scene, &scene.leaves.disparities, &scene.batch.plain.target);
    let value = match scene.loss.photometric {
        Photometric::ScSfm => {
            // A mean over both sources, where the program adds them up.
            target.add(of_scales(scene, &scene.leaves.source_disparities, &scene.sources().value()).scale(2.0))
        }
        _ => target,
    };
    vec![Term::new("smooth", weight, value, 1.0)]
}

/// The smoothness of maps of several scales under images of full size.
fn of_scales<'l>(scene: &Scene<'_, 'l>, disparities: &[Var<'l, f32>], images: &Tensor<f32>) -> Var<'l, f32> {
    // The SC-Depth programs look for edges in normalised colours.
    let edge = if scene.loss.photometric == Photometric::MinimumReprojection { 1.0 } else { 1.0 / COLOURS[1] };
    let scales = disparities.len();
    let parts = disparities.iter().enumerate().map(|(scale, &disparity)| {
        let s = disparity.shape();
        let image = scene.tape().constant(images.clone()).resize_bilinear(s.h(), s.w(), false).value();
        let map = match scene.loss.smoothness_of {
            SmoothnessOf::Disparity => disparity,
            SmoothnessOf::Depth => scene.range.depth(disparity),
        };
        normalised_edge_aware(map, &image, edge).scale(1.0 / (scales << scale) as f64)
    });
    parts.reduce(|a, b| a.add(b)).expect("at least one scale")
}
