//! `dimode weights inspect`, `convert` and `diff`.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use dimode_nets::NetKind;

use super::failure::Exit;
use super::options::refuse_unless;
use super::{output, summary};
use crate::run::weights::{ConvertRequest, DiffRequest, Input, convert, diff, inspect};

const INSPECT_ABOUT: &str = "\
Tell what a file of weights holds, and which networks it fits.

The file may be safetensors or one of PyTorch (.pth, .pt); its content tells which. Printed: every tensor with type, dimensions and \
statistics, what is left out, and the networks here that have exactly these tensors, or else the nearest. Nothing in a file is ever \
executed: whatever a PyTorch file asks for beyond tensors, dictionaries and plain values is named and refused.";

const INSPECT_EXAMPLES: &str = "\
Examples:
  dimode weights inspect encoder.pth
  dimode weights inspect raft-things.pth --json";

const CONVERT_ABOUT: &str = "\
Convert trained weights to safetensors files of a network.

Names and dimensions must be those of the network; otherwise all differences are listed and nothing is written. A file is \
known by its name (encoder.pth, depth.pth, pose_encoder.pth, pose.pth, posenet.pth), by its tensors, or by FILE=PATH. Names of other \
programs are translated: pose networks of sc_depth_pl and SC-SfMLearner, encoders trained on ImageNet (docs/weights.md). What is \
written is read back and compared before the folder appears.";

const CONVERT_EXAMPLES: &str = "\
Examples:
  dimode weights convert --net depth:lite_mono encoder.pth depth.pth --out lite-mono
  dimode weights convert --net pose:resnet18 pose_encoder.pth pose.pth --out pose
  dimode weights convert --net raft_full raft-things.pth --out raft
  dimode weights convert --net depth:resnet18 encoder=resnet18-imagenet.pth --out imagenet --partial";

const DIFF_ABOUT: &str = "\
Compare two files or folders of weights tensor by tensor.

Printed: what one of them misses, and tensors that are further apart than the tolerance, with the largest difference and the L2 norm \
of the difference over the larger of the two norms. Form, type of numbers and prefixes such as 'module.' do not matter.

The code is 0 when they are equal within the tolerance and 1 when not.";

const DIFF_EXAMPLES: &str = "\
Examples:
  dimode weights diff encoder.pth lite-mono/encoder.safetensors
  dimode weights diff before after --tolerance 1e-6 --json";

/// The commands for files of weights.
#[derive(Debug, Subcommand)]
pub enum Weights {
    Inspect(InspectArgs),
    Convert(ConvertArgs),
    Diff(DiffArgs),
}

impl Weights {
    /// Runs the command.
    pub fn run(self) -> anyhow::Result<Exit> {
        match self {
            Self::Inspect(args) => args.run(),
            Self::Convert(args) => args.run(),
            Self::Diff(args) => args.run(),
        }
    }
}

/// Flags of `dimode weights inspect`.
#[derive(Debug, Args)]
#[command(about = summary(INSPECT_ABOUT), long_about = INSPECT_ABOUT, after_help = INSPECT_EXAMPLES)]
pub struct InspectArgs {
    /// File of weights
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Print everything as JSON
    #[arg(long)]
    json: bool,
}

impl InspectArgs {
    fn run(self) -> anyhow::Result<Exit> {
        let found = inspect(&self.file)?;
        if self.json {
            output::json(&found)?;
        } else {
            output::text(&found.render())?;
        }
        Ok(Exit::Done)
    }
}

/// Flags of `dimode weights convert`.
#[derive(Debug, Args)]
#[command(about = summary(CONVERT_ABOUT), long_about = CONVERT_ABOUT, after_help = CONVERT_EXAMPLES)]
pub struct ConvertArgs {
    /// Network, such as depth:resnet18, pose:scipad or flow:raft_full; the role may be left out where the name is enough
    #[arg(long, value_name = "NET")]
    net: NetKind,
    /// Files of weights, as PATH or FILE=PATH, FILE being a file of the network
    #[arg(value_name = "FILE", required = true)]
    files: Vec<Input>,
    /// Folder to write; must be new or empty
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Take the tensors that fit, say what is skipped, and leave the others at their start values
    #[arg(long)]
    partial: bool,
    /// Seed of the start values
    #[arg(long, value_name = "N", default_value_t = 1, requires = "partial")]
    seed: u64,
    /// Replace what an earlier conversion wrote
    #[arg(long)]
    force: bool,
}

impl ConvertArgs {
    fn run(self) -> anyhow::Result<Exit> {
        let Self { net: network, files: inputs, out, partial, seed, force } = self;
        let request = ConvertRequest { network, inputs, out, partial, force, seed };
        let converted = convert(&request)?;
        output::text(&converted.render(&request))?;
        Ok(Exit::Done)
    }
}

/// Flags of `dimode weights diff`.
#[derive(Debug, Args)]
#[command(about = summary(DIFF_ABOUT), long_about = DIFF_ABOUT, after_help = DIFF_EXAMPLES)]
pub struct DiffArgs {
    /// File or folder of weights
    #[arg(value_name = "A")]
    a: PathBuf,
    /// File or folder of weights
    #[arg(value_name = "B")]
    b: PathBuf,
    /// Largest relative L2 difference of a tensor that counts as equal
    #[arg(long, value_name = "X", default_value_t = 0.0)]
    tolerance: f64,
    /// Print everything as JSON
    #[arg(long)]
    json: bool,
}

impl DiffArgs {
    fn run(self) -> anyhow::Result<Exit> {
        let Self { a, b, tolerance, json } = self;
        let fine = tolerance >= 0.0 && tolerance.is_finite();
        refuse_unless(fine, || format!("--tolerance {tolerance}"), "use a number from 0 on, for instance 1e-6")?;
        let found = diff(&DiffRequest { a, b, tolerance })?;
        if json {
            output::json(&found)?;
        } else {
            output::text(&found.render())?;
        }
        Ok(if found.equal { Exit::Done } else { Exit::Failed })
    }
}
