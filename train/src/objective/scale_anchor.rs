//! `scale`: the mean disparity stays where the sigmoid has slope.

use super::scene::Scene;
use super::term::{Term, TermKind, no_needs};
use crate::config::SCALE_ANCHOR;
use crate::losses::scale_anchor::scale_anchor;

pub(super) const KIND: TermKind = TermKind { needs: no_needs, measure };

fn measure<'l>(scene: &Scene<'_, 'l>) -> Vec<Term<'l>> {
    let weight = scene.loss.scale_anchor;
    if weight == 0.0 {
        return Vec::new();
    }
    vec![Term::new("scale", weight, scale_anchor(scene.leaves.disparities[0], SCALE_ANCHOR), 1.0)]
}
