//! `dimode pretrain flow`.

use std::path::PathBuf;

use clap::Args;
use dimode_nets::FlowNetKind;

use super::failure::Exit;
use super::options::{Size, preset, refuse_unless, refuse_unless_network_size};
use super::pretrain::{check_out, conclude};
use super::{interrupt, summary};
use crate::config::Preset;
use crate::pretrain::flow::{self, EndPointError, PretrainConfig, PretrainRequest};
use crate::progress::Bar;

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
    /// Size of the network: nano_raft_d4, nano_raft or raft_small
    #[arg(long, value_name = "NAME", default_value = "nano_raft_d4")]
    net: FlowNetKind,
    /// Kinds of worlds, taken in turn
    #[arg(long, value_name = "NAMES", value_delimiter = ',', value_parser = preset(), default_values = ["street", "handheld", "lateral"])]
    preset_mix: Vec<Preset>,
    /// Training steps
    #[arg(long, value_name = "N", default_value_t = PretrainConfig::default().steps)]
    steps: usize,
    /// Pairs in a step
    #[arg(long, value_name = "N", default_value_t = PretrainConfig::default().batch)]
    batch: usize,
    /// Size of the frames in pixels [default: 128x64]
    #[arg(long, value_name = "WxH")]
    size: Option<Size>,
    /// Refinements of the flow
    #[arg(long, value_name = "N", default_value_t = PretrainConfig::default().iterations)]
    iterations: usize,
    /// Full learning rate
    #[arg(long, value_name = "RATE", default_value_t = PretrainConfig::default().learning_rate)]
    learning_rate: f64,
    /// Seed of weights, worlds and augmentation
    #[arg(long, value_name = "N", default_value_t = PretrainConfig::default().seed)]
    seed: u64,
    /// Replace a file that is already there
    #[arg(long)]
    force: bool,
    /// Print the end-point errors as JSON
    #[arg(long)]
    json: bool,
}

impl PretrainFlowArgs {
    /// Trains and writes the file.
    pub fn run(self) -> anyhow::Result<Exit> {
        check_out(&self.out, self.force)?;
        let (json, out) = (self.json, self.out.clone());
        let request = PretrainRequest { out: out.clone(), config: self.settings()? };
        let stop = interrupt::stop_flag("stopping; nothing will be written")?;
        conclude(flow::train(&request, &Bar::new(), &stop), &stop, json, &out, line)
    }

    fn settings(self) -> anyhow::Result<PretrainConfig> {
        let base = PretrainConfig::default();
        let size = self.size.unwrap_or(Size { width: base.width, height: base.height });
        let config = PretrainConfig {
            flow: self.net,
            presets: self.preset_mix,
            width: size.width,
            height: size.height,
            steps: self.steps,
            batch: self.batch,
            iterations: self.iterations,
            learning_rate: self.learning_rate,
            warmup: base.warmup.min(self.steps / 2),
            seed: self.seed,
        };
        refuse_unless(config.steps > 0, || "--steps 0".to_owned(), "use 1 or more")?;
        refuse_unless(config.batch > 0, || "--batch 0".to_owned(), "use 1 or more")?;
        refuse_unless(config.iterations > 0, || "--iterations 0".to_owned(), "use 1 or more")?;
        let rate = config.learning_rate;
        refuse_unless(rate.is_finite() && rate > 0.0, || format!("--learning-rate {rate}"), "use a finite number above 0")?;
        refuse_unless_network_size(&size)?;
        Ok(config)
    }
}

fn line(e: &EndPointError) -> String {
    format!("{:10} end-point error {:.3} px (zero flow {:.3} px) over {} held-out pairs\n", e.preset, e.network, e.zero, e.pairs)
}
