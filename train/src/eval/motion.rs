//! Errors of single frame-to-frame motions: rotation angle and angle between translation directions.
//!
//! A motion is `source_from_target`, X_s = R X_t + t; its translation is expressed in the source camera's frame, and the
//! direction error compares the unit vectors of predicted and true t in that frame. Scale plays no part.

use dimode_geometry::{Se3, Trajectory};
use serde::Serialize;

use super::EvalError;
use super::align::robust_angle;
use super::depth::median;
use super::odometry::mean;

/// True translations shorter than this (metres) have no direction and are left out of the direction error.
pub const MIN_TRUE_STEP: f64 = 1e-6;
/// A predicted translation shorter than this has no direction; it is scored with a right angle.
const MIN_PREDICTED_STEP: f64 = 1e-12;

/// Frame-to-frame errors over a set of pairs, degrees.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct MotionErrors {
    /// Pairs that were compared.
    pub pairs: usize,
    /// Mean rotation error.
    pub rotation_mean_deg: f64,
    /// Median rotation error.
    pub rotation_median_deg: f64,
    /// Mean direction error; `None` when no pair has two directions.
    pub direction_mean_deg: Option<f64>,
    /// Median direction error.
    pub direction_median_deg: Option<f64>,
    /// Pairs whose true translation is below [`MIN_TRUE_STEP`]: no direction to compare with.
    pub direction_skipped: usize,
    /// Pairs whose predicted translation is zero; each counts as 90 degrees, unless all are so: then the direction error
    /// is not available.
    pub direction_undefined: usize,
    /// Rotation error of each pair in order.
    pub rotation_deg: Vec<f64>,
    /// Direction error of each pair in order, `None` where it was left out or is undefined.
    pub direction_deg: Vec<Option<f64>>,
}

/// Compares predicted with true motions `source_from_target`, pair by pair.
///
/// **Errors** for different counts, no pair at all, and values that are not finite.
pub fn motion_errors(predicted: &[Se3], truth: &[Se3]) -> Result<MotionErrors, EvalError> {
    if predicted.len() != truth.len() {
        return Err(EvalError::CountMismatch { what: "frame-to-frame motions", prediction: predicted.len(), truth: truth.len() });
    }
    if truth.is_empty() {
        return Err(EvalError::TooFew { what: "frame-to-frame motions", needed: 1, found: 0 });
    }
    let mut errors = MotionErrors { pairs: truth.len(), ..MotionErrors::default() };
    for (index, (p, g)) in predicted.iter().zip(truth).enumerate() {
        check("predicted motion", index, p)?;
        check("true motion", index, g)?;
        let rotation = p.rotation.transpose() * g.rotation;
        errors.rotation_deg.push(robust_angle(&rotation).to_degrees());
        let direction = direction_error(p, g, &mut errors);
        errors.direction_deg.push(direction);
    }
    summarise(&mut errors);
    Ok(errors)
}

fn check(which: &'static str, index: usize, motion: &Se3) -> Result<(), EvalError> {
    let numbers = motion.rotation.iter().chain(motion.translation.iter());
    if numbers.clone().all(|x| x.is_finite()) {
        return Ok(());
    }
    Err(EvalError::BadPose { which, index, reason: "is not finite" })
}

fn direction_error(p: &Se3, g: &Se3, errors: &mut MotionErrors) -> Option<f64> {
    if g.translation.norm() < MIN_TRUE_STEP {
        errors.direction_skipped += 1;
        return None;
    }
    if p.translation.norm() < MIN_PREDICTED_STEP {
        errors.direction_undefined += 1;
        return None;
    }
    let (a, b) = (p.translation.normalize(), g.translation.normalize());
    Some(a.cross(&b).norm().atan2(a.dot(&b)).to_degrees())
}

fn summarise(errors: &mut MotionErrors) {
    let mut rotation = errors.rotation_deg.clone();
    errors.rotation_mean_deg = mean(rotation.iter().copied()).unwrap_or(0.0);
    errors.rotation_median_deg = median(&mut rotation, false);
    let mut direction: Vec<f64> = errors.direction_deg.iter().flatten().copied().collect();
    if direction.is_empty() {
        return;
    }
    direction.extend(std::iter::repeat_n(90.0, errors.direction_undefined));
    errors.direction_mean_deg = mean(direction.iter().copied());
    errors.direction_median_deg = Some(median(&mut direction, false));
}

/// Frame-to-frame motions of a trajectory: for consecutive poses `next_from_this = W_next^-1 W_this`, that is
/// `source_from_target` with the earlier frame as target.
pub fn steps_of(trajectory: &Trajectory) -> Vec<Se3> {
    let pairs = trajectory.poses.windows(2);
    pairs
        .map(|pair| {
            let next = pair[1].world_from_camera.inverse();
            next.compose(&pair[0].world_from_camera)
        })
        .collect()
}

/// Trajectory of predicted steps under the frame indices and times of the true trajectory: starts at the identity, step k
/// being `source_from_target` of pose k as target and pose k + 1 as source.
///
/// **Errors** when there is not one pose more than steps.
pub fn follow(steps: &[Se3], truth: &Trajectory) -> Result<Trajectory, EvalError> {
    if steps.len() + 1 != truth.poses.len() {
        return Err(EvalError::CountMismatch {
            what: "frame-to-frame motions",
            prediction: steps.len(),
            truth: truth.poses.len().saturating_sub(1),
        });
    }
    let mut trajectory = Trajectory::accumulate(steps);
    for (pose, known) in trajectory.poses.iter_mut().zip(&truth.poses) {
        pose.index = known.index;
        pose.stamp = known.stamp;
    }
    Ok(trajectory)
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    fn motion(w: [f64; 3], t: [f64; 3]) -> Se3 {
        Se3::from_rotation_vector(&Vector3::from(w), Vector3::from(t))
    }

    #[test]
    fn known_angles() {
        let truth = [motion([0.0; 3], [0.0, 0.0, 2.0]), motion([0.0, 0.1, 0.0], [1.0, 0.0, 0.0])];
        let predicted = [motion([0.0, 0.02, 0.0], [0.0, 3.0, 3.0]), motion([0.0, 0.1, 0.0], [9.0, 0.0, 0.0])];
        let got = motion_errors(&predicted, &truth).unwrap();
        assert!((got.rotation_deg[0] - 0.02f64.to_degrees()).abs() < 1e-12);
        assert!(got.rotation_deg[1] < 1e-12);
        assert!((got.rotation_mean_deg - 0.01f64.to_degrees()).abs() < 1e-12);
        assert!((got.direction_deg[0].unwrap() - 45.0).abs() < 1e-12);
        assert!((got.direction_mean_deg.unwrap() - 22.5).abs() < 1e-12);
    }

    #[test]
    fn opposite_directions_are_180_degrees_apart() {
        let got = motion_errors(&[motion([0.0; 3], [0.0, 0.0, -1.0])], &[motion([0.0; 3], [0.0, 0.0, 5.0])]);
        assert!((got.unwrap().direction_mean_deg.unwrap() - 180.0).abs() < 1e-12);
    }

    #[test]
    fn standing_still_and_zero_predictions_are_counted() {
        let truth = [motion([0.0; 3], [0.0; 3]), motion([0.0; 3], [1.0, 0.0, 0.0]), motion([0.0; 3], [1.0, 0.0, 0.0])];
        let predicted = [truth[1], motion([0.0; 3], [0.0; 3]), truth[1]];
        let got = motion_errors(&predicted, &truth).unwrap();
        assert_eq!((got.direction_skipped, got.direction_undefined), (1, 1));
        assert_eq!(got.direction_mean_deg, Some(45.0));
        let nothing = motion_errors(&[Se3::identity(); 3], &truth).unwrap();
        assert_eq!(nothing.direction_mean_deg, None);
        assert_eq!(nothing.rotation_mean_deg, 0.0);
    }

    #[test]
    fn tiny_rotation_errors_are_not_lost() {
        let got = motion_errors(&[motion([1e-9, 0.0, 0.0], [0.0; 3])], &[Se3::identity()]).unwrap();
        assert!((got.rotation_mean_deg / 1e-9f64.to_degrees() - 1.0).abs() < 1e-6);
    }

    #[test]
    fn errors_are_clear() {
        assert!(motion_errors(&[], &[]).is_err());
        let one = [Se3::identity()];
        assert!(motion_errors(&one, &[]).unwrap_err().to_string().contains("1 predicted, but 0"));
        let bad = motion([0.0; 3], [f64::NAN, 0.0, 0.0]);
        assert!(motion_errors(&[bad], &one).unwrap_err().to_string().contains("frame 0 is not finite"));
    }

    #[test]
    fn steps_and_accumulation_invert_each_other() {
        let steps: Vec<Se3> = (0..9).map(|i| motion([0.01 * f64::from(i), -0.2, 0.03], [0.1, 0.2, f64::from(i)])).collect();
        let mut truth = Trajectory::accumulate(&steps);
        truth.poses.iter_mut().for_each(|pose| pose.index += 4);
        let trajectory = follow(&steps, &truth).unwrap();
        assert_eq!((trajectory.poses.len(), trajectory.poses[0].index), (10, 4));
        assert!(follow(&steps[1..], &truth).is_err());
        for (got, want) in steps_of(&trajectory).iter().zip(&steps) {
            assert!((got.rotation - want.rotation).norm() < 1e-12);
            assert!((got.translation - want.translation).norm() < 1e-12);
        }
    }
}
