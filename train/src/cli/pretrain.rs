//! What the commands of `dimode pretrain` share: flags, the way to the training, and how it ends.

use std::path::PathBuf;

use clap::Args;

use super::failure::Exit;
use super::options::{Size, preset, refuse_unless, refuse_unless_network_size};
use super::{interrupt, output};
use crate::config::Preset;
use crate::pretrain::{self, HeldOutError, Settings, Target, Task};
use crate::progress::Bar;
use crate::run::Stopped;

/// Flags that all networks have.
#[derive(Debug, Args)]
pub struct CommonArgs {
    /// Kinds of worlds that frames are taken from, in turn
    #[arg(long, value_name = "NAMES", value_delimiter = ',', value_parser = preset(), default_values = ["street", "handheld", "lateral"])]
    preset_mix: Vec<Preset>,
    /// Size of the frames in pixels [default: 128x64]
    #[arg(long, value_name = "WxH")]
    size: Option<Size>,
    /// Full learning rate
    #[arg(long, value_name = "RATE", default_value_t = 1e-3)]
    learning_rate: f64,
    /// Seed of weights, worlds and all else that is drawn
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Replace weights that are already there
    #[arg(long)]
    force: bool,
    /// Print the errors on held-out worlds as JSON
    #[arg(long)]
    json: bool,
}

impl CommonArgs {
    /// Checks settings and place, trains, writes the weights and prints the errors on held-out worlds.
    pub fn run<T: Task>(self, task: &T, steps: usize, batch: usize, out: PathBuf) -> anyhow::Result<Exit> {
        let (force, json) = (self.force, self.json);
        let settings = self.settings(steps, batch)?;
        let target = Target::new(out, T::FORM, force)?;
        let stop = interrupt::stop_flag("stopping; nothing will be written")?;
        let errors = match pretrain::train(task, &settings, &target, &Bar::new(), &stop) {
            Err(error) if error.is::<Stopped>() => return Ok(Exit::Interrupted),
            other => other?,
        };
        if json {
            output::json(&errors)?;
        } else {
            let lines: String = errors.iter().map(line::<T>).collect();
            output::text(&format!("{lines}wrote {}", target.path().display()))?;
        }
        Ok(Exit::Done)
    }

    fn settings(self, steps: usize, batch: usize) -> anyhow::Result<Settings> {
        let usual = Settings::new(steps, batch);
        let size = self.size.unwrap_or(Size { width: usual.width, height: usual.height });
        let rate = self.learning_rate;
        refuse_unless((1..=1 << 32).contains(&steps), || format!("--steps {steps}"), "use 1 to 4294967296")?;
        refuse_unless((1..=1024).contains(&batch), || format!("--batch {batch}"), "use 1 to 1024")?;
        refuse_unless(rate.is_finite() && rate > 0.0, || format!("--learning-rate {rate}"), "use a finite number above 0")?;
        refuse_unless_network_size(&size)?;
        let Size { width, height } = size;
        Ok(Settings { presets: self.preset_mix, width, height, learning_rate: rate, seed: self.seed, ..usual })
    }
}

fn line<T: Task>(e: &HeldOutError) -> String {
    let HeldOutError { preset, network, zero, pairs } = e;
    format!("{preset:10} {} {network:.3} px ({} {zero:.3} px) over {pairs} held-out pairs\n", T::MEASURE, T::BASELINE)
}
