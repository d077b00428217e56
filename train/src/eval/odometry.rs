//! Errors of whole trajectories: KITTI sub-sequence errors, absolute trajectory error, relative pose error.
//!
//! Predicted and true trajectory hold `world_from_camera` and are matched by frame index; both are moved so that the first
//! common frame lies at the origin, then aligned ([`Alignment`]).

use dimode_geometry::Trajectory;
use nalgebra::Matrix4;
use serde::{Deserialize, Serialize};

use super::EvalError;
use super::align::{Aligned, Alignment, Arithmetic, align_poses, position};

/// Every choice behind an odometry number.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct OdometryProtocol {
    /// Fit before the comparison.
    pub alignment: Alignment,
    /// Lengths of the sub-sequences along the true path, metres.
    pub lengths: Vec<f64>,
    /// Every how many frames a sub-sequence starts.
    pub start_step: usize,
    /// Formulas for inverse and angle.
    pub arithmetic: Arithmetic,
}

impl Default for OdometryProtocol {
    /// The KITTI setting: 100, 200, .. 800 m, a start every 10 frames, 7-degree alignment.
    fn default() -> Self {
        Self {
            alignment: Alignment::Sim3,
            lengths: (1..=8).map(|k| 100.0 * f64::from(k)).collect(),
            start_step: 10,
            arithmetic: Arithmetic::Compat,
        }
    }
}

impl OdometryProtocol {
    /// For paths of some ten metres: 5, 10, .. 40 m, a start at every frame, exact small angles.
    pub fn small_world() -> Self {
        Self {
            lengths: (1..=8).map(|k| 5.0 * f64::from(k)).collect(),
            start_step: 1,
            arithmetic: Arithmetic::Robust,
            ..Self::default()
        }
    }

    /// One line that says how the numbers were made.
    pub fn describe(&self) -> String {
        let lengths: Vec<String> = self.lengths.iter().map(f64::to_string).collect();
        format!(
            "{}, sub-sequences of {} m from every frame that is a multiple of {}",
            self.alignment.label(),
            lengths.join(", "),
            self.start_step
        )
    }

    fn check(&self) -> Result<(), EvalError> {
        let option = |option, value, requirement| EvalError::Option { option, value, requirement };
        if let Some(bad) = self.lengths.iter().find(|l| !(l.is_finite() && **l > 0.0)) {
            return Err(option("lengths", *bad, "must be finite and positive"));
        }
        if self.start_step == 0 {
            return Err(option("start_step", 0.0, "must be at least 1"));
        }
        Ok(())
    }
}

/// Sub-sequence errors of one length.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LengthErrors {
    /// Length, metres.
    pub length_m: f64,
    /// Sub-sequences of that length.
    pub segments: usize,
    /// Mean translation error, percent of the length.
    pub e_t_percent: f64,
    /// Mean rotation error, degrees per 100 m.
    pub e_r_deg_per_100m: f64,
}

/// Errors of one trajectory. `None` is "not available": no sub-sequence fits, or no two frames follow each other.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OdometryErrors {
    /// e_t: mean translation error over all sub-sequences, percent.
    pub e_t_percent: Option<f64>,
    /// e_r: mean rotation error over all sub-sequences, degrees per 100 m.
    pub e_r_deg_per_100m: Option<f64>,
    /// Number of sub-sequences.
    pub segments: usize,
    /// The same for each length that has sub-sequences.
    pub per_length: Vec<LengthErrors>,
    /// Absolute trajectory error: root mean square distance of aligned positions, metres.
    pub ate_m: f64,
    /// Relative pose error between consecutive frames, mean distance, metres.
    pub rpe_translation_m: Option<f64>,
    /// Relative pose error between consecutive frames, mean angle, degrees.
    pub rpe_rotation_deg: Option<f64>,
    /// Pairs behind the relative pose error.
    pub rpe_pairs: usize,
    /// Frames that were compared.
    pub frames: usize,
    /// Predicted frames without truth, left out.
    pub unmatched_frames: usize,
    /// Length of the true path, metres.
    pub path_length_m: f64,
    /// Factor put on the predicted positions.
    pub scale: f64,
    /// Whether the fitted rotation is arbitrary about the line of travel (positions on one line).
    pub rotation_ambiguous: bool,
}

/// Compares a predicted trajectory with the true one (`world_from_camera`, matched by frame index; the prediction may
/// cover fewer frames).
///
/// **Errors** for poses that are not finite, fewer than two common frames, and positions that do not determine the
/// alignment.
pub fn evaluate_odometry(
    prediction: &Trajectory,
    truth: &Trajectory,
    protocol: &OdometryProtocol,
) -> Result<OdometryErrors, EvalError> {
    protocol.check()?;
    let aligned = align_poses(prediction, truth, protocol.alignment, protocol.arithmetic)?;
    let path = path_lengths(&aligned);
    let segments = segment_errors(&aligned, &path, protocol);
    let (rpe_translation, rpe_rotation) = relative_errors(&aligned, protocol.arithmetic);
    let of_length = |length: f64| -> Option<LengthErrors> {
        let chosen: Vec<&Segment> = segments.iter().filter(|s| s.length == length).collect();
        Some(LengthErrors {
            length_m: length,
            segments: chosen.len(),
            e_t_percent: 100.0 * mean(chosen.iter().map(|s| s.translation))?,
            e_r_deg_per_100m: 100.0 * mean(chosen.iter().map(|s| s.rotation))?.to_degrees(),
        })
    };
    Ok(OdometryErrors {
        e_t_percent: mean(segments.iter().map(|s| s.translation)).map(|x| 100.0 * x),
        e_r_deg_per_100m: mean(segments.iter().map(|s| s.rotation)).map(|x| 100.0 * x.to_degrees()),
        segments: segments.len(),
        per_length: protocol.lengths.iter().filter_map(|l| of_length(*l)).collect(),
        ate_m: absolute_error(&aligned),
        rpe_translation_m: mean(rpe_translation.iter().copied()),
        rpe_rotation_deg: mean(rpe_rotation.iter().copied()).map(f64::to_degrees),
        rpe_pairs: rpe_translation.len(),
        frames: aligned.prediction.len(),
        unmatched_frames: aligned.unmatched,
        path_length_m: path.last().copied().unwrap_or(0.0),
        scale: aligned.scale,
        rotation_ambiguous: aligned.rotation_ambiguous,
    })
}

/// Mean of the values, `None` when there are none.
pub(crate) fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (mut sum, mut count) = (0.0, 0usize);
    for value in values {
        sum += value;
        count += 1;
    }
    (count > 0).then(|| sum / count as f64)
}

/// Error of one sub-sequence, per metre: translation without unit, rotation in radians per metre.
struct Segment {
    length: f64,
    translation: f64,
    rotation: f64,
}

/// Distance travelled up to each true frame, metres.
fn path_lengths(aligned: &Aligned) -> Vec<f64> {
    let positions: Vec<_> = aligned.truth.values().map(position).collect();
    let mut path = vec![0.0];
    for pair in positions.windows(2) {
        let so_far = path[path.len() - 1];
        path.push(so_far + (pair[1] - pair[0]).norm());
    }
    path
}

/// From every `start_step`-th true frame: the first later frame strictly beyond each length.
fn segment_errors(aligned: &Aligned, path: &[f64], protocol: &OdometryProtocol) -> Vec<Segment> {
    let a = protocol.arithmetic;
    let frames: Vec<usize> = aligned.truth.keys().copied().collect();
    let mut segments = Vec::new();
    for first in (0..frames.len()).step_by(protocol.start_step) {
        for &length in &protocol.lengths {
            let limit = path[first] + length;
            let last = first + path[first..].partition_point(|d| *d <= limit);
            if last == frames.len() {
                continue;
            }
            let ends = (frames[first], frames[last]);
            let prediction = &aligned.prediction;
            let (Some(from), Some(to)) = (prediction.get(&ends.0), prediction.get(&ends.1)) else {
                continue;
            };
            let travelled = a.relative(&aligned.truth[&ends.0], &aligned.truth[&ends.1]);
            let error = a.relative(&a.relative(from, to), &travelled);
            segments.push(Segment { length, translation: position(&error).norm() / length, rotation: a.angle(&error) / length });
        }
    }
    segments
}

fn absolute_error(aligned: &Aligned) -> f64 {
    let squares =
        aligned.prediction.iter().map(|(index, pose)| (position(pose) - position(&aligned.truth[index])).norm_squared());
    mean(squares).unwrap_or(0.0).sqrt()
}

/// Distance (metres) and angle (radians) of the relative error for all pairs of frames i, i + 1.
fn relative_errors(aligned: &Aligned, a: Arithmetic) -> (Vec<f64>, Vec<f64>) {
    let (mut distances, mut angles) = (Vec::new(), Vec::new());
    for (index, pose) in &aligned.prediction {
        let Some(next) = aligned.prediction.get(&(index + 1)) else {
            continue;
        };
        let moved: Matrix4<f64> = a.relative(&aligned.truth[index], &aligned.truth[&(index + 1)]);
        let error = a.relative(&moved, &a.relative(pose, next));
        distances.push(position(&error).norm());
        angles.push(a.angle(&error));
    }
    (distances, angles)
}

#[cfg(test)]
#[path = "odometry_tests.rs"]
mod tests;
