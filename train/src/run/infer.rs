//! Depth, motion and flow of every frame of a folder, by the networks of a run or by networks with weights of their own.

mod networks;
mod output;
mod sequence;
mod speed;

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Result;
use serde::Serialize;

use self::networks::Networks;
use self::sequence::Sequence;
use super::{Stopped, load_options};
use crate::data::staging::{Earlier, Staging};
use crate::data::{Dataset, LoadOptions, open};
use crate::progress::Progress;

pub use networks::{InferError, NamedNetworks, Source};
pub use output::{Form, Forms};
pub use speed::Speed;

/// What the depth becomes at which a network is held in training. Its own unit is below 1, where steps of 1/256 are coarse.
pub const USUAL_DEPTH: f64 = 10.0;

/// What to look at, with what, and where to put the result.
#[derive(Clone, Debug)]
pub struct InferRequest {
    /// The networks.
    pub source: Source,
    /// Folder of the frames.
    pub data: PathBuf,
    /// Sequences to use; empty for all.
    pub sequences: Vec<String>,
    /// Width and height that the networks see, in pixels; those of the run, or [`NamedNetworks::SIZE`], without.
    pub size: Option<(usize, usize)>,
    /// Refinements of the flow; those of the run or of the network without.
    pub flow_iterations: Option<usize>,
    /// Factor from the networks' own unit of depth to that of the files; without, a usual depth becomes [`USUAL_DEPTH`].
    pub unit: Option<f64>,
    /// What to write of depth and flow.
    pub forms: Forms,
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
    /// Length of the predicted path, in the unit of the depth files; none without a pose network.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub path_length: Option<f64>,
    /// Factor from the networks' own unit of depth to that of the files.
    pub unit: f64,
    /// Length of flow in pixels that has full colour; none without pictures of flow.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub flow_scale: Option<f64>,
    /// Frames per second.
    pub speed: Speed,
}

/// Writes a folder for each sequence: depth and flow in the forms that are asked for, at the size of the frames, and the
/// trajectory in KITTI and TUM form, in one unit with the depth. What has no network is not written. The folder appears complete
/// or not at all.
///
/// **Errors** of the networks ([`InferError`], and those of a run), of the data, what the system refuses, and [`Stopped`] soon
/// after `stop` is set.
pub fn infer(request: &InferRequest, progress: &dyn Progress, stop: &AtomicBool) -> Result<Vec<SequenceSummary>> {
    let staging = Staging::new(&request.out, Earlier::Keep)?;
    let networks = Networks::load(request)?;
    let options = LoadOptions {
        sequences: request.sequences.clone(),
        // Frames are made to fit the networks here, because what is written fits the frames.
        size: None,
        min_frames: 1,
        needs_camera: networks.needs_camera(),
        ..load_options(&networks.trained.config.data)
    };
    let dataset = open(&request.data, &options)?;
    staging.fill(|folder| write_all(&networks, &request.forms, dataset.as_ref(), folder, progress, stop))
}

fn write_all(
    networks: &Networks,
    forms: &Forms,
    dataset: &dyn Dataset,
    root: &Path,
    progress: &dyn Progress,
    stop: &AtomicBool,
) -> Result<Vec<SequenceSummary>> {
    let total: usize = (0..dataset.sequence_count()).map(|s| dataset.sequence_len(s)).sum();
    progress.start(total as u64, "frames");
    let mut done = 0;
    let mut summaries = Vec::new();
    for number in 0..dataset.sequence_count() {
        let name = dataset.sequence_name(number);
        let folder = root.join(&name);
        let sequence = Sequence { networks, forms, dataset, number, folder: &folder };
        summaries.push(sequence.write(&mut || {
            done += 1;
            progress.step(done as u64, &name);
            if stop.load(Ordering::Relaxed) { Err(Stopped.into()) } else { Ok(()) }
        })?);
    }
    progress.finish();
    Ok(summaries)
}
