//! Motion statistics of each preset, and clearance from geometry.

use nalgebra::Vector3;

use super::mean;
use crate::data::synthetic::face::Face;
use crate::data::synthetic::world::World;
use crate::data::synthetic::{Preset, SyntheticConfig};

/// Distance from a point to a face, by samples at most 0.25 m apart.
fn distance(face: &Face, point: &Vector3<f64>) -> f64 {
    let steps = |edge: &Vector3<f64>| ((edge.norm() / 0.25).ceil() as usize).max(1);
    let (n, m) = (steps(&face.edge_s), steps(&face.edge_t));
    let mut best = f64::INFINITY;
    for i in 0..=n {
        for j in 0..=m {
            let (s, t) = (i as f64 / n as f64, j as f64 / m as f64);
            if s + t <= face.limit + 1e-9 {
                best = best.min((face.origin + face.edge_s * s + face.edge_t * t - point).norm());
            }
        }
    }
    best
}

#[test]
fn camera_keeps_clear_of_all_geometry() {
    // A hand may lift the camera to 0.4 m below the ceiling of a low room.
    for (preset, least) in [(Preset::Street, 0.8), (Preset::Handheld, 0.39), (Preset::Lateral, 0.8)] {
        for seed in 0..12 {
            let config = SyntheticConfig { preset, seed, ..SyntheticConfig::default() };
            let world = World::new(&config, seed as usize);
            for pose in world.poses.iter().step_by(4) {
                let near = |face: &&Face| {
                    let middle = face.origin + 0.5 * (face.edge_s + face.edge_t);
                    let reach = 0.5 * (face.edge_s.norm() + face.edge_t.norm());
                    (middle - pose.translation).norm() < reach + 1.5 && reach < 40.0
                };
                for face in world.faces.iter().filter(near) {
                    let gap = distance(face, &pose.translation);
                    assert!(gap >= least, "{preset} seed {seed}: {gap} m");
                }
            }
        }
    }
}

/// Step lengths (m), rotation angles (degrees) and unit directions of translation in the target frame, over many worlds.
fn motions(preset: Preset) -> (Vec<f64>, Vec<f64>, Vec<Vector3<f64>>) {
    let (mut steps, mut angles, mut directions) = (Vec::new(), Vec::new(), Vec::new());
    let config = SyntheticConfig { preset, ..SyntheticConfig::default() };
    for sequence in 0..80 {
        let world = World::new(&config, sequence);
        for frame in 1..world.poses.len() {
            let motion = world.source_from_target(frame - 1, frame)[0];
            let moved = -motion.translation_in_from_frame();
            steps.push(moved.norm());
            angles.push(motion.rotation_angle().to_degrees());
            directions.push(moved.normalize());
        }
    }
    (steps, angles, directions)
}

fn range(values: &[f64]) -> [f64; 2] {
    let fold = |pick: fn(f64, f64) -> f64| values.iter().copied().reduce(pick).unwrap();
    [fold(f64::min), fold(f64::max)]
}

#[test]
fn street_moves_like_a_car() {
    let (steps, angles, directions) = motions(Preset::Street);
    let [low, high] = range(&steps);
    assert!(low > 0.28 && high < 0.95, "{low} {high}");
    assert!((0.65..0.95).contains(&mean(&angles)), "{}", mean(&angles));
    assert!(range(&angles)[1] < 5.0);
    let middle = directions.iter().sum::<Vector3<f64>>().normalize();
    assert!(middle.z > 0.99);
    let apart: Vec<f64> = directions.iter().map(|d| d.dot(&middle).clamp(-1.0, 1.0).acos().to_degrees()).collect();
    assert!((6.0..9.5).contains(&mean(&apart)), "{}", mean(&apart));
}

#[test]
fn handheld_turns_a_lot_and_moves_anywhere() {
    let (steps, angles, directions) = motions(Preset::Handheld);
    let ([low, high], [least, most]) = (range(&steps), range(&angles));
    assert!(low >= 0.04 && high <= 0.25, "{low} {high}");
    assert!(least >= 1.5 && most <= 5.0, "{least} {most}");
    assert!((2.7..3.3).contains(&mean(&angles)), "{}", mean(&angles));
    let middle = directions.iter().sum::<Vector3<f64>>() / directions.len() as f64;
    assert!(middle.norm() < 0.25, "no direction is preferred: {middle}");
    for axis in 0..3 {
        let share = mean(&directions.iter().map(|d| d[axis].abs()).collect::<Vec<_>>());
        assert!(share > 0.2, "axis {axis}: {share}");
    }
}

#[test]
fn lateral_moves_to_either_side() {
    let (steps, angles, directions) = motions(Preset::Lateral);
    let [low, high] = range(&steps);
    assert!(low >= 0.1 && high <= 0.5, "{low} {high}");
    assert!(range(&angles)[1] < 0.5, "{}", range(&angles)[1]);
    assert!(mean(&directions.iter().map(|d| d.x.abs()).collect::<Vec<_>>()) > 0.95);
    let right = directions.iter().filter(|d| d.x > 0.0).count() as f64 / directions.len() as f64;
    assert!((0.3..0.7).contains(&right), "{right}");
}
