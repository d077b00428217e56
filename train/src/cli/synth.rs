//! `dimode synth`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use super::failure::Exit;
use super::options::{Size, preset};
use super::{interrupt, output, summary};
use crate::config::Preset;
use crate::counted::counted;
use crate::data::synthetic::{Split, SyntheticConfig};
use crate::progress::Bar;
use crate::run::Stopped;
use crate::run::synth::{SynthRequest, synth};

const LONG_ABOUT: &str = "\
Render embedded worlds to a folder in KITTI odometry layout.

Each world becomes one sequence with colour frames, exact depth (16-bit PNG, metres x 256), exact flow to the next frame \
(KITTI flow PNG), poses and calibration. The same flags give the same bytes. The folder can be given to 'dimode train --data'.";

const EXAMPLES: &str = "\
Examples:
  dimode synth --out worlds                                        two street worlds of 30 frames
  dimode synth --preset handheld --worlds 4 --frames 60 --size 256x128 --out handheld
  dimode synth --night --noise 0.02 --out night";

/// Which family of worlds; training draws from `train`, evaluation from `held-out`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Family {
    /// Worlds that training uses
    Train,
    /// Worlds that evaluation uses
    HeldOut,
}

/// Flags of `dimode synth`.
#[derive(Debug, Args)]
#[command(about = summary(LONG_ABOUT), long_about = LONG_ABOUT, after_help = EXAMPLES)]
pub struct SynthArgs {
    /// Folder to write; must be new or empty, or written by this command and replaced with --force
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Kind of world
    #[arg(long, value_name = "NAME", default_value = "street", value_parser = preset())]
    preset: Preset,
    /// Number of worlds
    #[arg(long, value_name = "N", default_value_t = 2)]
    worlds: usize,
    /// Frames of each world
    #[arg(long, value_name = "N", default_value_t = 30)]
    frames: usize,
    /// Size of the frames in pixels
    #[arg(long, value_name = "WxH", default_value = "128x64")]
    size: Size,
    /// Seed of the worlds
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Family of worlds
    #[arg(long, value_name = "NAME", default_value = "train")]
    split: Family,
    /// Standard deviation of photometric noise, 0 to 0.5
    #[arg(long, value_name = "SIGMA", default_value_t = 0.0)]
    noise: f64,
    /// Strength of exposure changes, 0 to 1
    #[arg(long, value_name = "STRENGTH", default_value_t = 0.0)]
    exposure: f64,
    /// Dark worlds lit by the camera's own lights
    #[arg(long)]
    night: bool,
    /// Add an object that moves by itself
    #[arg(long)]
    moving_object: bool,
    /// Replace a folder that this command wrote before
    #[arg(long)]
    force: bool,
    /// Print a summary as JSON
    #[arg(long)]
    json: bool,
}

impl SynthArgs {
    /// Renders and writes.
    pub fn run(self) -> anyhow::Result<Exit> {
        let split = match self.split {
            Family::Train => Split::Train,
            Family::HeldOut => Split::HeldOut,
        };
        let worlds = SyntheticConfig {
            preset: self.preset,
            width: self.size.width,
            height: self.size.height,
            seed: self.seed,
            split,
            sequences: self.worlds,
            frames: self.frames,
            noise: self.noise,
            exposure: self.exposure,
            night: self.night,
            moving_object: self.moving_object,
        };
        let request = SynthRequest { worlds, out: self.out, overwrite: self.force };
        let stop = interrupt::stop_flag("stopping; nothing will be written")?;
        let summary = match synth(&request, &Bar::new(), &stop) {
            Err(error) if error.is::<Stopped>() => return Ok(Exit::Interrupted),
            other => other?,
        };
        if self.json {
            output::json(&summary)?;
        } else {
            let out = summary.out.display();
            let (sequences, frames) = (counted(summary.sequences, "sequence"), counted(summary.frames, "frame"));
            output::text(&format!("{sequences}, {frames} in {out}"))?;
        }
        Ok(Exit::Done)
    }
}
