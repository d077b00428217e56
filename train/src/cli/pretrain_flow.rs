//! `dimode pretrain flow`.

use std::path::PathBuf;

use clap::Args;
use dimode_nets::FlowNetKind;

use super::failure::Exit;
use super::options::refuse_unless;
use super::pretrain::CommonArgs;
use super::summary;
use crate::pretrain::{FlowTask, Task};

const LONG_ABOUT: &str = "\
Train the flow network on rendered pairs with exact flow.

The joint training starts from a flow network that has seen many pairs of frames with known flow. The weights that come with \
the program were made by this command; run it again for another size of network or another mix of worlds, and give the file to \
'dimode train --flow-weights FILE'. Every step renders new worlds, so no pair is seen twice.";

const EXAMPLES: &str = "\
Examples:
  dimode pretrain flow --out flow.safetensors
  dimode pretrain flow --out handheld.safetensors --preset-mix handheld --steps 6000 --seed 2";

/// Flags of `dimode pretrain flow`.
#[derive(Debug, Args)]
#[command(about = summary(LONG_ABOUT), long_about = LONG_ABOUT, after_help = EXAMPLES)]
pub struct PretrainFlowArgs {
    /// File to write (safetensors)
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Size of the network: nano_raft_d4, nano_raft, raft_small or raft_full
    #[arg(long, value_name = "NAME", default_value = "nano_raft_d4")]
    net: FlowNetKind,
    /// Refinements of the flow
    #[arg(long, value_name = "N", default_value_t = FlowTask::ITERATIONS)]
    iterations: usize,
    /// Training steps
    #[arg(long, value_name = "N", default_value_t = FlowTask::STEPS)]
    steps: usize,
    /// Pairs in a step
    #[arg(long, value_name = "N", default_value_t = FlowTask::BATCH)]
    batch: usize,
    #[command(flatten)]
    common: CommonArgs,
}

impl PretrainFlowArgs {
    /// Trains and writes the file.
    pub fn run(self) -> anyhow::Result<Exit> {
        let iterations = self.iterations;
        refuse_unless((1..=64).contains(&iterations), || format!("--iterations {iterations}"), "use 1 to 64")?;
        self.common.run(&FlowTask::new(self.net, iterations), self.steps, self.batch, self.out)
    }
}
