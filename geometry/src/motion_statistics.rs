//! What a recorded trajectory means for the paper's claims: sizes of its motions between neighbouring frames, and what the
//! printed alignment costs on them with perfect depth, motion and flow.
//!
//! Every frame is the target of both neighbours. With `t' = R^T t` of one direction, the other direction has `t = -t'`: over
//! both, sizes measured on `t` and on `t'` are the same.

use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

use crate::alignment::printed;
use crate::camera::Intrinsics;
use crate::error::GeometryError;
use crate::flow::gradients::tangential_influence_radius;
use crate::flow::tangential::focal_scaled;
use crate::motion::tangential_part;
use crate::se3::Se3;
use crate::trajectory::Trajectory;

/// What to count.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StatisticsOptions {
    /// Shortest translation of a pair that counts, in the unit of the poses.
    pub least_translation: f64,
    /// Shortest translation of both pairs of a triplet that counts.
    pub least_triplet_translation: f64,
    /// Smallest rotation of a pair that counts as turning, degrees.
    pub least_turn_deg: f64,
    /// Depth at which tangential flows are told, in the unit of the poses.
    pub depth: f64,
}

impl Default for StatisticsOptions {
    fn default() -> Self {
        Self { least_translation: 0.1, least_triplet_translation: 0.05, least_turn_deg: 1.0, depth: 20.0 }
    }
}

/// Percentiles of a list, by linear interpolation between neighbours in order.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Percentiles {
    /// Values behind them; values that are not finite (no direction, division by zero) are left out.
    pub count: usize,
    /// Below it lie 10 %.
    pub p10: f64,
    /// The median.
    pub p50: f64,
    /// Below it lie 90 %.
    pub p90: f64,
    /// Below it lie 99 %.
    pub p99: f64,
    /// The largest.
    pub max: f64,
}

impl Percentiles {
    /// Percentiles of the finite values; `None` when there is none.
    #[must_use]
    pub fn of(values: impl IntoIterator<Item = f64>) -> Option<Self> {
        let mut sorted: Vec<f64> = values.into_iter().filter(|x| x.is_finite()).collect();
        sorted.sort_unstable_by(f64::total_cmp);
        let max = *sorted.last()?;
        let at = |share: f64| {
            let place = share * (sorted.len() - 1) as f64;
            let below = sorted[place.floor() as usize];
            below + (sorted[place.ceil() as usize] - below) * place.fract()
        };
        Some(Self { count: sorted.len(), p10: at(0.1), p50: at(0.5), p90: at(0.9), p99: at(0.99), max })
    }
}

/// Numbers over the pairs that move. `t'` is the translation in the target frame, `delta = t' - t`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MotionStatistics {
    /// Pairs of neighbouring frames with a translation of at least `least_translation`, in both directions.
    pub pairs: usize,
    /// Rotation between neighbours, degrees.
    pub rotation_deg: Option<Percentiles>,
    /// `L_axi` of the printed alignment with perfect inputs, radians (closed form, no depth enters).
    pub axial_loss: Option<Percentiles>,
    /// Share of the pairs where that exceeds one degree.
    pub axial_loss_above_1_deg: f64,
    /// Share of the pairs where that exceeds two degrees.
    pub axial_loss_above_2_deg: f64,
    /// Circular `L_pla` of the printed alignment with perfect inputs.
    pub planar_loss: Option<Percentiles>,
    /// `|t_tan|`, in the unit of the poses.
    pub tangential: Option<Percentiles>,
    /// `|t_z| / |t_tan|`.
    pub radial_over_tangential: Option<Percentiles>,
    /// Tangential flow `|f o t_tan| / depth`, pixels: also the radius below which it dominates `df/dt_z`.
    pub tangential_flow: Option<Percentiles>,
    /// Share of the pairs where that is below half a pixel.
    pub tangential_flow_below_half_pixel: f64,
    /// Distance of the focus of expansion from the principal point, `|f o t_tan / t_z|`, pixels.
    pub focus_distance: Option<Percentiles>,
    /// Numbers over the pairs that turn.
    pub turning: TurningStatistics,
    /// Frames whose two neighbours both move by at least `least_triplet_translation`.
    pub triplets: usize,
    /// Share of the triplets whose two sources have `t'_z` of opposite sign.
    pub opposite_sources: f64,
}

/// Numbers over the pairs that turn by at least `least_turn_deg`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TurningStatistics {
    /// How many.
    pub pairs: usize,
    /// `L_axi` of the printed alignment with perfect inputs, radians.
    pub axial_loss: Option<Percentiles>,
    /// `|delta_x|`, in the unit of the poses.
    pub defect_x: Option<Percentiles>,
    /// `|t'_x|`, in the unit of the poses.
    pub in_target_x: Option<Percentiles>,
    /// `|delta_x / t'_x|`.
    pub defect_share_x: Option<Percentiles>,
    /// Share of these pairs where `t_x` and `t'_x` have opposite signs.
    pub opposite_signs: f64,
}

/// Motions `source_from_target` of every frame to the frames before and after it, where the file has them.
#[must_use]
pub fn neighbour_motions(trajectory: &Trajectory) -> Vec<[Option<Se3>; 2]> {
    let of = |index: usize| {
        let before = index.checked_sub(1).and_then(|source| trajectory.source_from_target(index, source));
        [before, trajectory.source_from_target(index, index + 1)]
    };
    trajectory.poses.iter().map(|p| of(p.index)).collect()
}

/// Offsets `d = p - p0` of every `step`-th pixel along both axes, the first half a step inside the image, row by row.
///
/// **Panics** for a step of 0.
#[must_use]
#[track_caller]
pub fn grid_offsets(camera: &Intrinsics, step: usize) -> Vec<Vector2<f64>> {
    assert!(step > 0, "grid_offsets: a step of 0 pixels");
    let along = |size: usize| (step / 2..size).step_by(step);
    let row = |v: usize| along(camera.width).map(move |u| Vector2::new(u as f64, v as f64));
    along(camera.height).flat_map(row).map(|p| p - camera.principal_point()).collect()
}

/// Statistics of recorded trajectories, each with poses `world_from_camera`, over pixels at `offsets` from the principal point.
///
/// **Units**: translations in the unit of the poses (metres for KITTI), rotations in degrees, losses in radians.
///
/// # Errors
/// [`GeometryError::DegenerateTrajectory`] when no pair moves.
pub fn motion_statistics(
    trajectories: &[Trajectory],
    camera: &Intrinsics,
    offsets: &[Vector2<f64>],
    options: &StatisticsOptions,
) -> Result<MotionStatistics, GeometryError> {
    let neighbours: Vec<_> = trajectories.iter().flat_map(neighbour_motions).collect();
    let moving = |least: f64| move |motion: &Se3| motion.translation.norm() > least;
    let pairs: Vec<Se3> = neighbours.iter().flatten().flatten().copied().filter(moving(options.least_translation)).collect();
    if pairs.is_empty() {
        let reason = format!("no two neighbouring frames are more than {} apart", options.least_translation);
        return Err(GeometryError::DegenerateTrajectory { reason });
    }
    let triplets: Vec<[Se3; 2]> = neighbours
        .iter()
        .filter_map(|&[before, after]| Some([before?, after?]))
        .filter(|both| both.iter().all(moving(options.least_triplet_translation)))
        .collect();
    Ok(of_pairs(&pairs, &triplets, camera, offsets, options))
}

/// Statistics of given pairs and triplets.
fn of_pairs(
    pairs: &[Se3],
    triplets: &[[Se3; 2]],
    camera: &Intrinsics,
    offsets: &[Vector2<f64>],
    options: &StatisticsOptions,
) -> MotionStatistics {
    let axial: Vec<f64> = pairs.iter().map(|m| printed::axial_loss(camera, m, offsets)).collect();
    let axial_above = |degrees: f64| share(&axial, |&x| x > degrees.to_radians());
    let in_target = |m: &Se3| m.translation_in_from_frame();
    let tangential = |m: &Se3| tangential_part(&in_target(m)).norm();
    let flows: Vec<f64> = pairs.iter().map(|m| tangential_influence_radius(camera, &in_target(m), options.depth)).collect();
    let over = |value: &dyn Fn(&Se3) -> f64| Percentiles::of(pairs.iter().map(value));
    MotionStatistics {
        pairs: pairs.len(),
        rotation_deg: over(&|m| m.rotation_angle().to_degrees()),
        axial_loss: Percentiles::of(axial.iter().copied()),
        axial_loss_above_1_deg: axial_above(1.0),
        axial_loss_above_2_deg: axial_above(2.0),
        planar_loss: over(&|m| printed::planar_loss(camera, m, offsets)),
        tangential: over(&tangential),
        radial_over_tangential: over(&|m| in_target(m).z.abs() / tangential(m)),
        tangential_flow: Percentiles::of(flows.iter().copied()),
        tangential_flow_below_half_pixel: share(&flows, |&flow| flow < 0.5),
        focus_distance: over(&|m| focal_scaled(camera, &in_target(m)).norm() / in_target(m).z.abs()),
        turning: turning(pairs, &axial, options.least_turn_deg),
        triplets: triplets.len(),
        opposite_sources: share(triplets, |[before, after]| in_target(before).z * in_target(after).z < 0.0),
    }
}

fn turning(pairs: &[Se3], axial: &[f64], least_deg: f64) -> TurningStatistics {
    let turns = pairs.iter().zip(axial).filter(|(m, _)| m.rotation_angle().to_degrees() > least_deg);
    let turns: Vec<(Se3, f64)> = turns.map(|(&m, &loss)| (m, loss)).collect();
    let defect = |m: &Se3| printed::defect(m).x.abs();
    let in_target = |m: &Se3| m.translation_in_from_frame().x;
    let over = |value: &dyn Fn(&Se3) -> f64| Percentiles::of(turns.iter().map(|(m, _)| value(m)));
    TurningStatistics {
        pairs: turns.len(),
        axial_loss: Percentiles::of(turns.iter().map(|&(_, loss)| loss)),
        defect_x: over(&defect),
        in_target_x: over(&|m| in_target(m).abs()),
        defect_share_x: over(&|m| defect(m) / in_target(m).abs()),
        opposite_signs: share(&turns, |(m, _)| m.translation.x * in_target(m) < 0.0),
    }
}

/// Share of a list that a property holds for; 0 for an empty list.
fn share<T>(list: &[T], property: impl Fn(&T) -> bool) -> f64 {
    list.iter().filter(|x| property(x)).count() as f64 / list.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::scenes;

    fn statistics(steps: &[Se3]) -> Result<MotionStatistics, GeometryError> {
        let scene = scenes::road();
        motion_statistics(&[Trajectory::accumulate(steps)], &scene.camera, &scene.offsets(), &StatisticsOptions::default())
    }

    #[test]
    fn percentiles_lie_between_neighbours() {
        let p = Percentiles::of([5.0, 1.0, f64::NAN, 2.0, 4.0, 3.0, f64::INFINITY]).unwrap();
        assert_eq!((p.count, p.p10, p.p50, p.p90, p.max), (5, 1.4, 3.0, 4.6, 5.0));
        assert!((p.p99 - 4.96).abs() < 1e-15);
        assert_eq!(Percentiles::of([f64::NAN]), None);
    }

    #[test]
    fn the_grid_of_the_road_is_every_sixteenth_pixel() {
        assert_eq!(grid_offsets(&scenes::kitti640(), 16), scenes::road().offsets());
    }

    #[test]
    fn straight_driving_costs_nothing() {
        let s = statistics(&[Se3 { translation: Vector3::new(0.02, 0.0, -1.0), ..Se3::identity() }; 4]).unwrap();
        assert_eq!((s.pairs, s.triplets, s.opposite_sources, s.turning.pairs), (8, 3, 1.0, 0));
        assert!(s.axial_loss.unwrap().max < 1e-12 && s.planar_loss.unwrap().max < 1e-12);
        assert!((s.focus_distance.unwrap().p50 - 7.424).abs() < 1e-9);
        assert!((s.radial_over_tangential.unwrap().max - 50.0).abs() < 1e-9);
        assert!((s.tangential_flow.unwrap().p50 - 0.3712).abs() < 1e-12);
        assert_eq!((s.tangential_flow_below_half_pixel, s.turning.axial_loss), (1.0, None));
    }

    #[test]
    fn standing_still_is_no_motion() {
        let message = statistics(&[Se3::identity(); 3]).unwrap_err().to_string();
        assert!(message.contains("0.1"), "{message}");
    }
}
