//! `l_loc` in its parts, `l_loc_normals`, `l_loc_angles`, `l_loc_ranking`: the local structure of the depth is that of a
//! pseudo-depth.

use dimode_autodiff::{Tensor, Var, rng};

use super::needs::Needs;
use super::scene::Scene;
use super::term::{Term, TermKind};
use super::view_pairs;
use crate::config::{LocalStructure, LossConfig, PseudoDepth, StageConfig};
use crate::losses::depth_ranking::{depth_ranking, random_dynamic_pairs, random_global_pairs};
use crate::losses::guided_filter::self_guided;
use crate::losses::local_structure::normal_matching;
use crate::losses::relative_normal::edge_guided_relative_normal;

pub(super) const KIND: TermKind = TermKind { needs, measure };

/// Separates the random pairs of this term from other random numbers of a step.
const PAIRS: u64 = 0x6c6f_6361_6c00;

fn ranks(loss: &LocalStructure, stage: &StageConfig) -> bool {
    stage.lambda3 > 0.0 && loss.depth_ranking > 0.0 && loss.pseudo_depth != PseudoDepth::None
}

fn needs(loss: &LossConfig, stage: &StageConfig) -> Needs {
    if ranks(&loss.local_structure, stage) { view_pairs::NEEDS } else { Needs::default() }
}

fn measure<'l>(scene: &Scene<'_, 'l>) -> Vec<Term<'l>> {
    let (settings, lambda3) = (&scene.loss.local_structure, scene.stage.lambda3);
    if lambda3 == 0.0 {
        return Vec::new();
    }
    let depth = scene.target_depth();
    let Some(pseudo) = pseudo_depth(scene, depth) else { return Vec::new() };
    let (images, cameras) = (&scene.batch.plain.target, &scene.batch.intrinsics);
    let seed = |k| rng::splitmix64(scene.seed ^ PAIRS, k);
    let mut terms = Vec::new();
    let mut add = |name, weight: f64, value: &dyn Fn() -> Var<'l, f32>| {
        if weight > 0.0 {
            terms.push(Term::new(name, lambda3 * weight, value(), 1.0));
        }
    };
    add("l_loc_normals", settings.normal_matching, &|| normal_matching(depth, &pseudo, cameras));
    add("l_loc_angles", settings.relative_normal, &|| edge_guided_relative_normal(depth, &pseudo, images, cameras, seed(0)));
    add("l_loc_ranking", settings.depth_ranking, &|| {
        let global = random_global_pairs(depth.shape().plane(), seed(1));
        depth_ranking(depth, &pseudo, &global, &random_dynamic_pairs(&view_pairs::static_weight(scene), seed(2)))
    });
    terms
}

fn pseudo_depth(scene: &Scene<'_, '_>, depth: Var<'_, f32>) -> Option<Tensor<f32>> {
    match scene.loss.local_structure.pseudo_depth {
        PseudoDepth::None => None,
        PseudoDepth::SelfGuided => Some(self_guided(&depth.value(), &scene.batch.plain.target)),
        PseudoDepth::Rendered | PseudoDepth::Folder => {
            Some(scene.batch.pseudo_depth.clone().expect("the batch was loaded with its pseudo-depth"))
        }
    }
}
