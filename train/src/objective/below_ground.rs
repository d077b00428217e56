//! `below_ground`: nothing is seen below the ground that the disparities themselves show (Dynamo-Depth).

use dimode_autodiff::rng;

use super::scene::Scene;
use super::term::{Term, TermKind, no_needs};
use crate::losses::below_ground::below_own_ground;
use crate::losses::ground_plane::GroundSearch;

pub(super) const KIND: TermKind = TermKind { needs: no_needs, measure };

/// Separates the points that are drawn for a plane from other random numbers of a step.
const PLANES: u64 = 0x0067_726f_756e_6400;

fn measure<'l>(scene: &Scene<'_, 'l>) -> Vec<Term<'l>> {
    let weight = scene.loss.below_ground;
    if weight == 0.0 {
        return Vec::new();
    }
    let seed = rng::splitmix64(scene.seed ^ PLANES, 0);
    let cameras = &scene.batch.intrinsics;
    let value = below_own_ground(scene.leaves.disparities[0], cameras, scene.range, GroundSearch::default(), seed);
    vec![Term::new("below_ground", weight, value, 1.0)]
}
