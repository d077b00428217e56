//! What is true between two frames: pose, flow, visibility.

use dimode_geometry::Intrinsics;

use super::raycast::View;
use super::world::World;
use crate::data::{FlowMap, PairTruth};

/// Largest relative difference between the depth of a target point in the source and the depth the source sees there.
const DEPTH_TOLERANCE: f64 = 0.01;

/// Pixels by which rounding may push a point over the border of the image.
const ROUNDING: f64 = 1e-6;

/// Truth from target frame `target` to source frame `source` of a world.
///
/// The flow follows the target point (on the moving object, with its motion); it is 0 where the target sees the sky or the
/// point is not in front of the source. `visible` says that the point projects into the source image (between the first and
/// the last pixel centre), that the source sees it there (a ray through that very place hits the same depth within 1 %), and
/// that it belongs to the static scene: pixels of the moving object are left out, because depth and camera motion do not
/// explain them.
pub fn pair_truth(world: &World, intrinsics: &Intrinsics, target: usize, source: usize) -> PairTruth {
    let (width, height) = (intrinsics.width, intrinsics.height);
    let target_view = View::new(world, target, intrinsics);
    let source_view = View::new(world, source, intrinsics);
    let motions = world.source_from_target(target, source);
    let mut flow = FlowMap::zeros(height, width);
    let mut visible = vec![false; width * height];
    for v in 0..height {
        for u in 0..width {
            let (column, row) = (u as f64, v as f64);
            let Some(hit) = target_view.cast(column, row) else {
                continue;
            };
            let moving = world.faces[target_view.faces[hit.index].face].moving;
            let point = motions[usize::from(moving)].transform(&(intrinsics.ray(column, row) * hit.depth));
            let Some(place) = intrinsics.project(&point) else {
                continue;
            };
            let pixel = v * width + u;
            flow.u[pixel] = (place.x - column) as f32;
            flow.v[pixel] = (place.y - row) as f32;
            let inside = (-ROUNDING..=width as f64 - 1.0 + ROUNDING).contains(&place.x)
                && (-ROUNDING..=height as f64 - 1.0 + ROUNDING).contains(&place.y);
            visible[pixel] = !moving
                && inside
                && source_view
                    .cast(place.x, place.y)
                    .is_some_and(|seen| (seen.depth - point.z).abs() <= DEPTH_TOLERANCE * point.z);
        }
    }
    PairTruth { source_from_target: motions[0], flow, visible }
}

/// Which pixels of a frame see the moving object, row by row.
pub fn moving_mask(world: &World, intrinsics: &Intrinsics, frame: usize) -> Vec<bool> {
    let view = View::new(world, frame, intrinsics);
    (0..intrinsics.width * intrinsics.height)
        .map(|i| {
            let (u, v) = ((i % intrinsics.width) as f64, (i / intrinsics.width) as f64);
            view.cast(u, v).is_some_and(|hit| world.faces[view.faces[hit.index].face].moving)
        })
        .collect()
}
