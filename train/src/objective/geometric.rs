//! `l_pla`, `l_axi`, `l_tan`, `l_rad`: the four geometric losses of the paper.

use dimode_autodiff::Tensor;
use dimode_geometry::losses as geometric;

use super::needs::{FlowWays, Needs, SourceDepth};
use super::report::ImageReport;
use super::scene::Scene;
use super::term::{Term, TermKind};
use crate::config::{LossConfig, Sources, StageConfig};

pub(super) const KIND: TermKind = TermKind { needs, measure };

fn is_on(stage: &StageConfig) -> bool {
    stage.lambda1 > 0.0 || stage.lambda2 > 0.0
}

fn needs(loss: &LossConfig, stage: &StageConfig) -> Needs {
    if !is_on(stage) {
        return Needs::default();
    }
    let source_depth = if loss.geometric.detach_source_depth { SourceDepth::Value } else { SourceDepth::Gradient };
    Needs { source_depth, flow: FlowWays::to_trust(loss.occlusion) }
}

fn measure<'l>(scene: &Scene<'_, 'l>) -> Vec<Term<'l>> {
    let (options, stage) = (&scene.loss.geometric, scene.stage);
    if !is_on(stage) {
        return Vec::new();
    }
    let (rigid, flow, motion) = (scene.rigid_flow().value(), scene.flow().forward, scene.motion());
    let mask = chosen_sources(scene, options.static_mask.among(scene.trusted(), &rigid, &flow.value()));
    let inputs = geometric::PairInputs {
        target_depth: scene.depth(),
        source_depth: scene.source_depth(),
        flow,
        rotation: motion.rotation,
        translation: motion.translation,
        intrinsics: &scene.cameras,
        mask: &mask,
    };
    let weights = [stage.lambda1, stage.lambda1, stage.lambda2, stage.lambda2];
    let losses = ["l_pla", "l_axi", "l_tan", "l_rad"].into_iter().zip(weights).zip(four_losses(&inputs, options, weights));
    // Of the sources that were not chosen no pixel is asked for.
    let asked = mask.shape().len() as f64 * if scene.loss.sources == Sources::Both { 1.0 } else { 0.5 };
    let chosen = losses.filter(|((_, weight), _)| *weight > 0.0);
    let measured = chosen.map(|((name, weight), measured)| {
        let pixels = measured.counts.iter().sum::<usize>() as f64;
        let images = images(&measured);
        Term { images, ..Term::new(name, weight, measured.mean, pixels / asked) }
    });
    measured.collect()
}

/// Planar, axial, tangential and radial loss, as one operation where there is one; those without weight may be anything.
fn four_losses<'l>(
    inputs: &geometric::PairInputs<'_, 'l, f32>,
    options: &geometric::LossOptions,
    weights: [f64; 4],
) -> [geometric::LossTerm<'l, f32>; 4] {
    match geometric::fused::geometric_losses(inputs, options, weights.map(|weight| weight > 0.0)) {
        Some(losses) => losses,
        None => {
            let pair = geometric::AlignedPair::new(inputs, options);
            [
                geometric::planar(&pair, options),
                geometric::axial(&pair, options),
                geometric::tangential(&pair, options),
                geometric::radial(&pair, options),
            ]
        }
    }
}

/// Leaves out the previous frames where only the next ones are wanted.
fn chosen_sources(scene: &Scene<'_, '_>, mask: Tensor<f32>) -> Tensor<f32> {
    if scene.loss.sources == Sources::Both {
        return mask;
    }
    let half = mask.shape().len() / 2;
    let data = mask.data().iter().enumerate().map(|(i, &m)| if i < half { 0.0 } else { m }).collect();
    Tensor::from_vec(mask.shape(), data)
}

/// Value and pixels of every target and source, previous sources first.
fn images(measured: &geometric::LossTerm<'_, f32>) -> Vec<ImageReport> {
    let values = measured.per_image.value();
    let images = values.data().iter().zip(&measured.counts);
    images.map(|(&value, &pixels)| ImageReport { value: value.into(), pixels }).collect()
}
