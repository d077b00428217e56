//! `dimode cost`.

use clap::Args;
use dimode_nets::NetKind;

use super::failure::{Exit, UsageError};
use super::options::{Size, refuse_unless};
use super::{output, summary};
use crate::data::MAX_SIDE;
use crate::progress::Bar;
use crate::run::cost::{CostRequest, cost};

const LONG_ABOUT: &str = "\
Print what networks cost: parameters, multiply-accumulates, size on the disk, time and memory.

Multiply-accumulates are those of convolutions and matrix products of one forward pass as the network is defined, \
batch 1. Time and memory are measured on this machine without gradients, after a pass to warm up. Parameters count everything \
that a checkpoint stores as such, unused tensors included. Pose and flow networks look at a pair of frames.";

const EXAMPLES: &str = "\
Examples:
  dimode cost                                      every network at 640x192
  dimode cost depth:resnet18 pose:resnet18 raft_small
  dimode cost --size 96x64 --no-time               counts alone, at the size of small runs
  dimode cost raft_small --iterations 24 --json
  dimode cost depth:resnet18 --threads 1 --runs 11";

/// Flags of `dimode cost`.
#[derive(Debug, Args)]
#[command(about = summary(LONG_ABOUT), long_about = LONG_ABOUT, after_help = EXAMPLES)]
pub struct CostArgs {
    /// Networks, such as depth:resnet18, pose:nano or flow:raft_small; the role may be left out where the name is enough [default: all]
    #[arg(value_name = "NET")]
    networks: Vec<NetKind>,
    /// Size of the images in pixels
    #[arg(long, value_name = "WxH", default_value = "640x192")]
    size: Size,
    /// Refinements of flow networks [default: those of each network]
    #[arg(long, value_name = "N")]
    iterations: Option<usize>,
    /// Timed forward passes; the median is told
    #[arg(long, value_name = "N", default_value_t = 5)]
    runs: usize,
    /// Count only: no time, no memory
    #[arg(long, conflicts_with = "runs")]
    no_time: bool,
    /// Print everything as JSON
    #[arg(long)]
    json: bool,
}

impl CostArgs {
    /// Counts, times and prints.
    pub fn run(self) -> anyhow::Result<Exit> {
        let json = self.json;
        let report = cost(&self.request()?, &Bar::new())?;
        if json {
            output::json(&report)?;
        } else {
            output::text(&report.render_table())?;
        }
        Ok(Exit::Done)
    }

    fn request(self) -> Result<CostRequest, UsageError> {
        let Size { width, height } = self.size;
        let sides = 1..=MAX_SIDE;
        let what = || format!("--size {width}x{height}");
        refuse_unless(sides.contains(&width) && sides.contains(&height), what, &format!("use sides of 1 to {MAX_SIDE}"))?;
        let iterations = self.iterations.unwrap_or(1);
        refuse_unless((1..=64).contains(&iterations), || format!("--iterations {iterations}"), "use 1 to 64")?;
        refuse_unless((1..=1000).contains(&self.runs), || format!("--runs {}", self.runs), "use 1 to 1000, or --no-time")?;
        // A network that was asked for by name must fit; in the list of all, the others still tell something.
        for network in &self.networks {
            let fits = network.check_size(height, width);
            fits.map_err(|unfit| UsageError::new(unfit.to_string(), "give a --size that fits"))?;
        }
        let networks = if self.networks.is_empty() { NetKind::all().collect() } else { self.networks };
        let runs = if self.no_time { 0 } else { self.runs };
        Ok(CostRequest { networks, width, height, iterations: self.iterations, runs })
    }
}
