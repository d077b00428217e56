//! Rendering worlds to a folder.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Result;
use serde::Serialize;

use super::Stopped;
use crate::data::synthetic::{SyntheticConfig, SyntheticDataset};
use crate::data::write_kitti;
use crate::progress::Progress;

/// What to render and where to put it.
#[derive(Clone, Debug)]
pub struct SynthRequest {
    /// The worlds.
    pub worlds: SyntheticConfig,
    /// Folder to write.
    pub out: PathBuf,
    /// Replace a folder of the same layout.
    pub overwrite: bool,
}

/// What was written.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct SynthSummary {
    /// The folder.
    pub out: PathBuf,
    /// Sequences, one for each world.
    pub sequences: usize,
    /// Frames in all sequences.
    pub frames: usize,
    /// Depth pictures.
    pub depth_maps: usize,
    /// Flow pictures.
    pub flow_maps: usize,
}

/// Renders the worlds in KITTI odometry layout; the folder appears complete or not at all.
///
/// **Errors** [`crate::data::DataError`] for settings out of range, an occupied folder, and what the system refuses;
/// [`Stopped`] soon after `stop` is set.
pub fn synth(request: &SynthRequest, progress: &dyn Progress, stop: &AtomicBool) -> Result<SynthSummary> {
    let dataset = SyntheticDataset::new(request.worlds.clone())?;
    let total = request.worlds.sequences.saturating_mul(request.worlds.frames) as u64;
    progress.start(total, "frames");
    let mut tell = |done: usize, _all: usize| {
        progress.step(done as u64, "");
        if stop.load(Ordering::Relaxed) { Err(anyhow::Error::from(Stopped)) } else { Ok(()) }
    };
    let written = write_kitti(&dataset, &request.out, request.overwrite, &mut tell);
    progress.finish();
    let written = written?;
    Ok(SynthSummary {
        out: request.out.clone(),
        sequences: written.sequences,
        frames: written.frames,
        depth_maps: written.depth_maps,
        flow_maps: written.flow_maps,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::{LoadOptions, open};
    use crate::progress::Recorder;

    #[test]
    fn what_is_written_can_be_read_as_a_dataset() {
        let place = tempfile::tempdir().unwrap();
        let worlds = SyntheticConfig { width: 32, height: 16, sequences: 2, frames: 3, ..SyntheticConfig::default() };
        let request = SynthRequest { worlds, out: place.path().join("worlds"), overwrite: false };
        let recorder = Recorder::default();
        let go = AtomicBool::new(false);
        let summary = synth(&request, &recorder, &go).unwrap();
        assert_eq!((summary.sequences, summary.frames, summary.depth_maps), (2, 6, 6));
        assert_eq!(recorder.lines().last().map(String::as_str), Some("finish"));
        let read = open(&request.out, &LoadOptions::default()).unwrap();
        assert_eq!((read.sequence_count(), read.sequence_len(1)), (2, 3));
        assert!(synth(&request, &recorder, &go).is_err(), "an occupied folder is refused");
    }

    #[test]
    fn a_stop_leaves_nothing_behind() {
        let place = tempfile::tempdir().unwrap();
        let worlds = SyntheticConfig { width: 32, height: 16, sequences: 1, frames: 3, ..SyntheticConfig::default() };
        let request = SynthRequest { worlds, out: place.path().join("worlds"), overwrite: false };
        let error = synth(&request, &Recorder::default(), &AtomicBool::new(true)).unwrap_err();
        assert!(error.is::<Stopped>());
        assert_eq!(std::fs::read_dir(place.path()).unwrap().count(), 0);
    }
}
