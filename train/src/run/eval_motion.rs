//! Scoring the motion of a trained run.

use std::path::PathBuf;

use anyhow::Result;
use dimode_geometry::{Se3, Trajectory};

use super::TrainedModel;
use super::conclude::{means_of, motion_table};
use super::eval_odometry::OdometryChanges;
use super::frames::frames_to_score;
use crate::data::DataError;
use crate::eval::Evaluation;
use crate::progress::Progress;

/// What is scored, and how.
#[derive(Clone, Debug)]
pub struct EvalMotionRequest {
    /// Folder of the run.
    pub run: PathBuf,
    /// Folder of frames with true poses; without one the data of the run, or worlds that it was not trained on.
    pub data: Option<PathBuf>,
    /// Sequences to use; empty for all.
    pub sequences: Vec<String>,
    /// Looks of the pose network, if not those of the run.
    pub looks: Option<usize>,
    /// What is asked to differ from the protocol of a report.
    pub changes: OdometryChanges,
}

/// Scores predicted motions beside zero motion and the mean training motion, frame to frame and as trajectories.
///
/// **Errors** of the run and the data; when no sequence has true poses; [`crate::eval::EvalError`];
/// [`crate::config::ConfigError`] for a number of looks out of range.
pub fn eval_motion(request: &EvalMotionRequest, progress: &dyn Progress) -> Result<Evaluation> {
    let mut model = TrainedModel::load(&request.run)?;
    if let Some(looks) = request.looks {
        model.config.nets.pose_test_iterations = looks;
        model.config.nets.validate()?;
    }
    let dataset = frames_to_score(&model.config, request.data.as_deref(), &request.sequences)?;
    let all = 0..dataset.sequence_count();
    progress.start(all.clone().map(|s| dataset.sequence_len(s) as u64).sum(), "frames");
    let mut done = 0;
    let mut scored: Vec<(String, Vec<Se3>, Trajectory)> = Vec::new();
    for sequence in all {
        let mut poses = Vec::with_capacity(dataset.sequence_len(sequence));
        let steps = model.walk(dataset.as_ref(), sequence, &mut |_, frame, _| {
            poses.push(frame.world_from_camera);
            done += 1;
            progress.step(done, "");
            Ok(())
        })?;
        if let Some(poses) = poses.into_iter().collect::<Option<Vec<Se3>>>() {
            scored.push((dataset.sequence_name(sequence), steps, Trajectory::from_poses(poses)));
        }
    }
    progress.finish();
    let sequences: Vec<_> = scored.iter().map(|(name, steps, truth)| (name.as_str(), &steps[..], truth)).collect();
    let motion = motion_table(&sequences, means_of(&model.config)?.1, &request.changes)?;
    if motion.is_none() {
        let reason = "no sequence has true poses";
        let advice = "name a folder with poses, or leave --data out to score on embedded worlds";
        return Err(DataError::malformed(&PathBuf::from(dataset.name()), reason, advice).into());
    }
    let (title, data) = (request.run.display().to_string(), dataset.name());
    Ok(Evaluation { title, data, depth: None, motion, notes: Vec::new() })
}
