//! `dimode pretrain pose`.

use std::path::PathBuf;

use clap::Args;
use dimode_nets::PoseNetKind;

use super::failure::Exit;
use super::options::refuse_unless;
use super::pretrain::CommonArgs;
use super::summary;
use crate::pretrain::{PoseTask, Task};

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
    /// Folder to write pose_encoder.safetensors and pose.safetensors to, or posenet.safetensors with SCIPaD
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Size of the network: nano, resnet18, nano_scipad or scipad
    #[arg(long, value_name = "NAME", default_value = "nano")]
    net: PoseNetKind,
    /// Training steps
    #[arg(long, value_name = "N", default_value_t = PoseTask::STEPS)]
    steps: usize,
    /// Pairs in a step, an even number
    #[arg(long, value_name = "N", default_value_t = PoseTask::BATCH)]
    batch: usize,
    #[command(flatten)]
    common: CommonArgs,
}

impl PretrainPoseArgs {
    /// Trains and writes the files.
    pub fn run(self) -> anyhow::Result<Exit> {
        refuse_unless(self.batch.is_multiple_of(2), || format!("--batch {}", self.batch), "use an even number, 2 to 1024")?;
        self.common.run(&PoseTask::new(self.net), self.steps, self.batch, self.out)
    }
}
