//! `contextual`, `rigid`, `divergence`: depth, flow and motion agree without decomposing the flow (DCPI-Depth).

use dimode_autodiff::{Tensor, Var};
use dimode_geometry::taped::rigid_flow;

use super::needs::{FlowWays, Needs};
use super::scene::{Scene, share};
use super::term::{Term, TermKind};
use crate::config::{ContextualDepth, LossConfig, Sources, StageConfig};
use crate::losses::contextual_divergence::{DivergenceForm, divergence_agreement};
use crate::losses::contextual_geometric::{ContextualForm, ContextualInputs, TriangulatedForm, radial_depth, triangulated_depth};
use crate::losses::gated::Gated;
use crate::losses::rigid_agreement::rigid_agreement;

pub(super) const KIND: TermKind = TermKind { needs, measure };

fn is_on(stage: &StageConfig) -> bool {
    stage.contextual > 0.0 || stage.rigid > 0.0 || stage.divergence > 0.0
}

fn needs(_: &LossConfig, stage: &StageConfig) -> Needs {
    let flow = if is_on(stage) { FlowWays::Forward } else { FlowWays::None };
    Needs { flow, ..Needs::default() }
}

fn measure<'l>(scene: &Scene<'_, 'l>) -> Vec<Term<'l>> {
    let stage = scene.stage;
    if !is_on(stage) {
        return Vec::new();
    }
    let (start, len) = chosen_samples(scene);
    let cut = |x: Var<'l, f32>| x.slice(0, start, len);
    let rotational = cut(rotational_flow(scene)).value();
    let inputs = ContextualInputs {
        flow: cut(scene.flow().forward),
        depth: cut(scene.depth()),
        rotation: cut(scene.motion().rotation),
        translation: cut(scene.motion().translation),
        rotational: &rotational,
        intrinsics: &scene.cameras[start..start + len],
    };
    let mut terms = Vec::new();
    let mut add = |name, weight, gated: &dyn Fn() -> Gated<'l, f32>| {
        if weight > 0.0 {
            let Gated { mean, kept, .. } = gated();
            terms.push(Term::new(name, weight, mean, share(&kept)));
        }
    };
    let centre = ContextualForm::Corrected;
    add("contextual", stage.contextual, &|| match scene.loss.contextual_depth {
        ContextualDepth::Radial => radial_depth(&inputs, centre),
        ContextualDepth::Triangulated => triangulated_depth(&inputs, TriangulatedForm::Corrected),
    });
    add("rigid", stage.rigid, &|| rigid_agreement(inputs.flow, &cut(scene.rigid_flow()).value()));
    add("divergence", stage.divergence, &|| divergence_agreement(&inputs, centre, DivergenceForm::Corrected));
    terms
}

/// First and number of the stacked samples that `loss.sources` names.
fn chosen_samples(scene: &Scene<'_, '_>) -> (usize, usize) {
    match scene.loss.sources {
        Sources::Both => (0, 2 * scene.samples()),
        Sources::Next => (scene.samples(), scene.samples()),
    }
}

/// The flow of the rotation alone, `[2 n, 2, h, w]`, without gradient: any depth draws it.
fn rotational_flow<'l>(scene: &Scene<'_, 'l>) -> Var<'l, f32> {
    let (tape, motion) = (scene.tape(), scene.motion());
    let depth = tape.constant(Tensor::full(scene.depth().shape(), 1.0));
    let still = tape.constant(Tensor::zeros(motion.translation.shape()));
    rigid_flow(depth, motion.rotation.detach(), still, &scene.cameras).slice(1, 0, 2)
}
