//! `dimode infer`.

use std::path::PathBuf;

use clap::Args;

use super::failure::Exit;
use super::{interrupt, output, summary};
use crate::counted::counted;
use crate::progress::Bar;
use crate::run::Stopped;
use crate::run::infer::{InferRequest, SequenceSummary, infer};

const LONG_ABOUT: &str = "\
Write depth and trajectory of every frame of a folder.

For each sequence: depth/ (16-bit PNG, value = depth x 256), depth_colour/ (for the eye, near is bright), and the trajectory as \
trajectory.kitti.txt (12 numbers a line) and trajectory.tum.txt (time, position, quaternion). Depth and positions have \
one unit, in which a usual depth is 10; from a single camera its length is not known.";

const EXAMPLES: &str = "\
Examples:
  dimode infer --run runs/train-street-s1 --data DIR --out predictions
  dimode infer --run runs/train-kitti-s1 --data kitti --sequences 09 --out predictions-09";

/// Flags of `dimode infer`.
#[derive(Debug, Args)]
#[command(about = summary(LONG_ABOUT), long_about = LONG_ABOUT, after_help = EXAMPLES)]
pub struct InferArgs {
    /// Folder of the trained run
    #[arg(long, value_name = "RUN")]
    run: PathBuf,
    /// Folder of frames, as for 'dimode train --data'
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// Sequences of the folder, with commas [default: all]
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    sequences: Vec<String>,
    /// Folder to write; must be new or empty
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Print a summary as JSON
    #[arg(long)]
    json: bool,
}

impl InferArgs {
    /// Predicts and writes.
    pub fn run(self) -> anyhow::Result<Exit> {
        let request = InferRequest { run: self.run, data: self.data, sequences: self.sequences, out: self.out };
        let stop = interrupt::stop_flag("stopping; nothing will be written")?;
        let bar = Bar::new();
        let summaries = match infer(&request, &bar, &stop) {
            Err(error) if error.is::<Stopped>() => return Ok(Exit::Interrupted),
            other => other?,
        };
        if self.json {
            output::json(&summaries)?;
        } else {
            let line = |s: &SequenceSummary| {
                format!(
                    "{}: {}, path of {:.2} units in {}\n",
                    s.name,
                    counted(s.frames, "frame"),
                    s.path_length,
                    request.out.join(&s.name).display()
                )
            };
            output::text(&summaries.iter().map(line).collect::<String>())?;
        }
        Ok(Exit::Done)
    }
}
