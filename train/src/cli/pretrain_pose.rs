//! `dimode pretrain pose`.

use std::path::PathBuf;

use clap::Args;
use dimode_nets::PoseNetKind;

use super::failure::Exit;
use super::options::{Size, preset, refuse_unless, refuse_unless_network_size};
use super::pretrain::{check_out, conclude};
use super::{interrupt, summary};
use crate::config::Preset;
use crate::pretrain::pose::{self, MotionError, PosePretraining};
use crate::progress::Bar;

const LONG_ABOUT: &str = "\
Train the pose network on single pictures that are moved.

A rendered picture is moved by a random motion before a random depth, and the network learns to tell the motion. No true depth \
or motion of a world is used: the training stands in for encoders that have seen ImageNet. The weights that come with the \
program were made by this command; give another folder to 'dimode train --pose-weights DIR'.";

const EXAMPLES: &str = "\
Examples:
  dimode pretrain pose --out pose
  dimode pretrain pose --out resnet18 --net resnet18 --steps 3000 --batch 4";

/// Flags of `dimode pretrain pose`.
#[derive(Debug, Args)]
#[command(about = summary(LONG_ABOUT), long_about = LONG_ABOUT, after_help = EXAMPLES)]
pub struct PretrainPoseArgs {
    /// Folder to write pose_encoder.safetensors and pose.safetensors to
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Size of the network: nano or resnet18
    #[arg(long, value_name = "NAME", default_value = "nano")]
    net: PoseNetKind,
    /// Kinds of worlds that pictures are taken from, in turn
    #[arg(long, value_name = "NAMES", value_delimiter = ',', value_parser = preset(), default_values = ["street", "handheld", "lateral"])]
    preset_mix: Vec<Preset>,
    /// Training steps
    #[arg(long, value_name = "N", default_value_t = PosePretraining::default().steps)]
    steps: usize,
    /// Pairs in a step, an even number
    #[arg(long, value_name = "N", default_value_t = PosePretraining::default().batch)]
    batch: usize,
    /// Size of the pictures in pixels [default: 128x64]
    #[arg(long, value_name = "WxH")]
    size: Option<Size>,
    /// Full learning rate
    #[arg(long, value_name = "RATE", default_value_t = PosePretraining::default().learning_rate)]
    learning_rate: f64,
    /// Seed of weights, pictures, depths and motions
    #[arg(long, value_name = "N", default_value_t = PosePretraining::default().seed)]
    seed: u64,
    /// Replace a folder that is already there
    #[arg(long)]
    force: bool,
    /// Print the errors as JSON
    #[arg(long)]
    json: bool,
}

impl PretrainPoseArgs {
    /// Trains and writes the files.
    pub fn run(self) -> anyhow::Result<Exit> {
        check_out(&self.out, self.force)?;
        refuse_unless(!self.out.is_file(), || format!("{}: is a file", self.out.display()), "name a folder")?;
        let (json, out) = (self.json, self.out.clone());
        let config = self.settings()?;
        let stop = interrupt::stop_flag("stopping; nothing will be written")?;
        conclude(pose::train(&config, &out, &Bar::new(), &stop), &stop, json, &out, line)
    }

    fn settings(self) -> anyhow::Result<PosePretraining> {
        let base = PosePretraining::default();
        let size = self.size.unwrap_or(Size { width: base.width, height: base.height });
        refuse_unless(self.steps > 0, || "--steps 0".to_owned(), "use 1 or more")?;
        let even = self.batch > 0 && self.batch.is_multiple_of(2);
        refuse_unless(even, || format!("--batch {}", self.batch), "use an even number, 2 or more")?;
        let rate = self.learning_rate;
        refuse_unless(rate.is_finite() && rate > 0.0, || format!("--learning-rate {rate}"), "use a finite number above 0")?;
        refuse_unless_network_size(&size)?;
        Ok(PosePretraining {
            pose: self.net,
            presets: self.preset_mix,
            width: size.width,
            height: size.height,
            steps: self.steps,
            batch: self.batch,
            learning_rate: rate,
            warmup: base.warmup.min(self.steps / 2),
            seed: self.seed,
        })
    }
}

fn line(e: &MotionError) -> String {
    format!(
        "{:10} difference of flows {:.3} px (no motion {:.3} px) over {} held-out pairs\n",
        e.preset, e.network, e.zero, e.pairs
    )
}
