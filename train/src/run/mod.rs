//! What the commands do: one file per task, called by the command line and by tests.

pub mod conclude;
pub mod cost;
pub mod eval_depth;
pub mod eval_motion;
pub mod eval_odometry;
pub mod first_weights;
pub mod folder;
pub mod frames;
pub mod infer;
pub mod synth;
pub mod train;
pub mod trained;
pub mod verify;
pub mod weights;

use std::path::{Path, PathBuf};

use crate::config::Config;

pub use folder::{RunError, RunFolder};
pub use frames::{checked_frames, held_out_worlds, load_options, open_frames, training_frames};
pub use trained::TrainedModel;

/// The work was stopped on request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("stopped on request")]
pub struct Stopped;

/// What to train and where to put it.
#[derive(Clone, Debug)]
pub struct TrainRequest {
    /// All settings, flags already applied.
    pub config: Config,
    /// Folder of the run; made when missing.
    pub out: PathBuf,
    /// What to do with a run that is already there.
    pub start: Start,
    /// The command that asks for the run, for `config.toml` and the report.
    pub command: String,
}

impl TrainRequest {
    /// Goes on with the run in a folder, with its own settings.
    ///
    /// **Errors** [`RunError::NoRun`] and [`crate::config::ConfigError`].
    pub fn resume(run: &Path) -> anyhow::Result<Self> {
        let folder = RunFolder::open(run)?;
        let command = folder.command().unwrap_or_else(|| format!("dimode train --resume {}", run.display()));
        Ok(Self { config: folder.read_config()?, out: run.to_owned(), start: Start::Resume, command })
    }
}

/// How a run begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Start {
    /// In a folder without a run; a run that is already there is refused.
    New,
    /// In place of the run that is there.
    Replace,
    /// From the checkpoint of the run that is there, with its settings: see [`TrainRequest::resume`].
    Resume,
}

/// How training ended.
#[derive(Clone, Debug, PartialEq)]
pub enum TrainOutcome {
    /// All steps are done; evaluation and report are written.
    Finished {
        /// The table of metrics for a terminal.
        table: String,
        /// The content of `metrics.json`.
        metrics: serde_json::Value,
        /// The report.
        report: PathBuf,
        /// Hash of the last checkpoint, as hexadecimal digits.
        checkpoint_hash: String,
    },
    /// Stopped on request after a complete step, which is saved.
    Interrupted {
        /// Steps done.
        step: u64,
    },
}
