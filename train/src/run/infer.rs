//! Depth and trajectory of every frame of a folder.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Result;
use dimode_geometry::Trajectory;
use serde::Serialize;

use super::{Stopped, TrainedModel, open_frames};
use crate::data::staging::{Earlier, Staging};
use crate::data::{DataError, Dataset, Map, write_atomic, write_depth_png};
use crate::progress::Progress;
use crate::report::picture::Picture;
use crate::report::write_trajectory;

/// What the depth becomes at which a network is held in training. Its own unit is below 1, where steps of 1/256 are coarse.
pub const USUAL_DEPTH: f64 = 10.0;

/// The largest depth that a picture holds.
const FARTHEST: f32 = 65535.0 / 256.0;

/// What to look at and where to put the result.
#[derive(Clone, Debug)]
pub struct InferRequest {
    /// Folder of the trained run.
    pub run: PathBuf,
    /// Folder of the frames.
    pub data: PathBuf,
    /// Sequences to use; empty for all.
    pub sequences: Vec<String>,
    /// Folder to write; must not exist, or be empty.
    pub out: PathBuf,
}

/// What was written for one sequence.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SequenceSummary {
    /// Name of the sequence, and of its folder.
    pub name: String,
    /// Frames.
    pub frames: usize,
    /// Length of the predicted path, in the unit of the depth pictures.
    pub path_length: f64,
}

/// Writes `SEQUENCE/depth/NAME.png` (16 bit, unit x 256), `SEQUENCE/depth_colour/NAME.png`, and the trajectory in KITTI and
/// TUM form, all in one unit, in which a usual depth is [`USUAL_DEPTH`]. The folder appears complete or not at all.
///
/// **Errors** of the run, of the data, what the system refuses, and [`Stopped`] soon after `stop` is set.
pub fn infer(request: &InferRequest, progress: &dyn Progress, stop: &AtomicBool) -> Result<Vec<SequenceSummary>> {
    let staging = Staging::new(&request.out, Earlier::Keep)?;
    let model = TrainedModel::load(&request.run)?;
    let mut data = model.config.data.clone();
    data.sequences.clone_from(&request.sequences);
    let dataset = open_frames(&request.data, &data, 1)?;
    staging.fill(|folder| write_all(&model, dataset.as_ref(), folder, progress, stop))
}

fn write_all(
    model: &TrainedModel,
    dataset: &dyn Dataset,
    root: &Path,
    progress: &dyn Progress,
    stop: &AtomicBool,
) -> Result<Vec<SequenceSummary>> {
    let total: usize = (0..dataset.sequence_count()).map(|s| dataset.sequence_len(s)).sum();
    progress.start(total as u64, "frames");
    let mut done = 0;
    let mut summaries = Vec::new();
    for sequence in 0..dataset.sequence_count() {
        let name = dataset.sequence_name(sequence);
        let folder = root.join(&name);
        let trajectory = write_sequence(model, dataset, sequence, &folder, &mut || {
            done += 1;
            progress.step(done as u64, &name);
            if stop.load(Ordering::Relaxed) { Err(Stopped.into()) } else { Ok(()) }
        })?;
        let (frames, path_length) = (trajectory.len(), trajectory.path_length());
        summaries.push(SequenceSummary { name: name.clone(), frames, path_length });
    }
    progress.finish();
    Ok(summaries)
}

fn write_sequence(
    model: &TrainedModel,
    dataset: &dyn Dataset,
    sequence: usize,
    folder: &Path,
    done: &mut dyn FnMut() -> Result<()>,
) -> Result<Trajectory> {
    for name in ["depth", "depth_colour"] {
        let folder = folder.join(name);
        fs::create_dir_all(&folder).map_err(|error| DataError::write(&folder, error))?;
    }
    let unit = USUAL_DEPTH / model.model.range.usual();
    let mut steps = model.walk(dataset, sequence, &mut |_, frame, mut depth| {
        depth.data.iter_mut().for_each(|z| *z = (*z * unit as f32).min(FARTHEST));
        write_depth(&frame.name, &depth, folder)?;
        done()
    })?;
    steps.iter_mut().for_each(|step| step.translation *= unit);
    let mut trajectory = Trajectory::accumulate(&steps);
    if let Some(times) = dataset.times(sequence) {
        for (pose, &time) in trajectory.poses.iter_mut().zip(times) {
            pose.stamp = Some(time);
        }
    }
    write_trajectory(folder, "trajectory", &trajectory)?;
    Ok(trajectory)
}

fn write_depth(name: &str, depth: &Map, folder: &Path) -> Result<(), DataError> {
    write_depth_png(&folder.join("depth").join(format!("{name}.png")), depth)?;
    let (near, far) = spread(&depth.data).unwrap_or((0.5 * USUAL_DEPTH, 2.0 * USUAL_DEPTH));
    let picture = Picture::from_depth(depth, 1.0, near, far);
    write_atomic(&folder.join("depth_colour").join(format!("{name}.png")), &picture.to_png())
}

/// The 2 % and 98 % points, so that a few far pixels do not darken the picture.
fn spread(values: &[f32]) -> Option<(f64, f64)> {
    let mut sorted: Vec<f32> = values.iter().copied().filter(|value| value.is_finite() && *value > 0.0).collect();
    sorted.sort_unstable_by(f32::total_cmp);
    let last = sorted.len().checked_sub(1)?;
    let at = |share: f64| f64::from(sorted[(share * last as f64).round() as usize]);
    Some((at(0.02), at(0.98).max(1.05 * at(0.02))))
}
