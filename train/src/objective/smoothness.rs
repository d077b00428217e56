//! `smooth`: edge-aware smoothness of disparity or depth, halved at each coarser scale, mean over scales.

use super::scene::Scene;
use super::term::{Term, TermKind, no_needs};
use crate::config::SmoothnessOf;
use crate::losses::smoothness::smoothness;

pub(super) const KIND: TermKind = TermKind { needs: no_needs, measure };

fn measure<'l>(scene: &Scene<'_, 'l>) -> Vec<Term<'l>> {
    let weight = scene.loss.smoothness;
    if weight == 0.0 {
        return Vec::new();
    }
    let scales = scene.leaves.disparities.len();
    let parts = scene.leaves.disparities.iter().enumerate().map(|(scale, &disparity)| {
        let image = scene.target_like(disparity);
        let map = match scene.loss.smoothness_of {
            SmoothnessOf::Disparity => disparity,
            SmoothnessOf::Depth => scene.range.depth(disparity),
        };
        smoothness(map, &image).scale(1.0 / (scales << scale) as f64)
    });
    let value = parts.reduce(|a, b| a.add(b)).expect("at least one scale");
    vec![Term::new("smooth", weight, value, 1.0)]
}
