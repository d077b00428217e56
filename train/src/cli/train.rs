//! `dimode train`.

use std::path::PathBuf;

use clap::Args;

use super::failure::Exit;
use super::options::{Size, Stages, loss, preset};
use super::{interrupt, output, summary};
use crate::config::{Config, FirstWeights, LossPreset, Preset};
use crate::progress::{Bar, Progress};
use crate::run::{self, RunFolder, Start, TrainOutcome, TrainRequest};

const LONG_ABOUT: &str = "\
Train the networks, evaluate them, write a report.

Without --data the frames come from an embedded world that is rendered while training runs, and the result is scored on \
worlds that were not trained on. With --data they come from a folder; no ground truth is used in training, but poses and depth \
are scored against it where they are there.

DIR of --data is one of
  a KITTI odometry folder    DIR/sequences/NN/image_2/*.png (or image_0), calib.txt, and if you have them DIR/poses/NN.txt
  a folder of frames         DIR/*.png or *.jpg in the order of their names, and DIR/intrinsics.txt

Every setting has a name in a TOML file (--config); --print-config shows all of them with their values, and those \
without a value as comments. Flags win over the file, the file wins over the defaults.";

const EXAMPLES: &str = "\
Examples:
  dimode train --quick                          small and short: a first look
  dimode train --preset handheld --seed 2       another world, another seed
  dimode train --stages 1                       all steps in stage 1, for comparison
  dimode train --loss monodepth2                another method's loss on the same networks and data
  dimode train --data kitti --sequences 09 --size 192x64
  dimode train --set train.warmup=50 --set loss.smoothness=0.002 --set train.stages.3.lambda2=0.2
  dimode train --print-config > my.toml         a file to edit; then: dimode train --config my.toml
  dimode train --resume runs/train-street-s1    go on after Ctrl-C or a crash, with the same bits

The run folder holds report.html, metrics.json, log.jsonl, config.toml and checkpoint.safetensors.";

/// Flags of `dimode train`.
#[derive(Debug, Args)]
#[command(about = summary(LONG_ABOUT), long_about = LONG_ABOUT, after_help = EXAMPLES)]
pub struct TrainArgs {
    /// Settings in a TOML file
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Folder of real frames [default: the embedded world]
    #[arg(long, value_name = "DIR", conflicts_with = "preset")]
    data: Option<PathBuf>,
    /// Sequences of the folder, with commas [default: all]
    #[arg(long, value_name = "NAMES", value_delimiter = ',', requires = "data")]
    sequences: Vec<String>,
    /// Kind of the embedded world [default: street]
    #[arg(long, value_name = "NAME", value_parser = preset())]
    preset: Option<Preset>,
    /// Small frames and few steps: a first look in about two minutes
    #[arg(long)]
    quick: bool,
    /// Training steps of all stages together [default: 3600]
    #[arg(long, value_name = "N")]
    steps: Option<u64>,
    /// Snippets in a step [default: 4]
    #[arg(long, value_name = "N")]
    batch: Option<usize>,
    /// Seed of everything random: the same seed gives the same bits [default: 1]
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Full learning rate [default: 0.001]
    #[arg(long, value_name = "RATE")]
    learning_rate: Option<f64>,
    /// Size of the frames the networks see, multiples of 32 [default: 128x64]
    #[arg(long, value_name = "WxH")]
    size: Option<Size>,
    /// Stages to train: 1, 1,2 or 1,2,3; the steps of the others go to the last one named
    #[arg(long, value_name = "LIST")]
    stages: Option<Stages>,
    /// Lengths of DiMoDE's stages (5, 10, 15 of 30 epochs) and learning rate (1e-4) of the paper, meant for pre-trained encoders
    #[arg(long)]
    paper_schedule: bool,
    /// Loss and stages of a method [default: dimode]
    #[arg(long, value_name = "NAME", value_parser = loss())]
    loss: Option<LossPreset>,
    /// First weights of the depth network: random or a folder
    #[arg(long, value_name = "WHICH")]
    depth_weights: Option<FirstWeights>,
    /// First weights of the flow network: embedded, random or a file
    #[arg(long, value_name = "WHICH")]
    flow_weights: Option<FirstWeights>,
    /// First weights of the pose network: embedded, random or a folder
    #[arg(long, value_name = "WHICH")]
    pose_weights: Option<FirstWeights>,
    /// Any other setting by its name in the file, for instance train.warmup=50; may be repeated
    #[arg(long = "set", value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Folder of the run [default: runs/train-<data>-s<seed>]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Replace a run that is already in the folder
    #[arg(long)]
    force: bool,
    /// Go on with the run in this folder, with its own settings
    #[arg(long, value_name = "DIR", conflicts_with_all = [
        "config", "data", "sequences", "preset", "quick", "steps", "batch", "seed", "learning_rate", "size", "stages",
        "paper_schedule", "loss", "depth_weights", "flow_weights", "pose_weights", "set", "out", "force",
    ])]
    resume: Option<PathBuf>,
    /// Print the metrics as JSON instead of tables
    #[arg(long)]
    json: bool,
    /// Print all settings as TOML, those without a value as comments, and end
    #[arg(long)]
    print_config: bool,
}

impl TrainArgs {
    /// Trains, or prints the settings.
    pub fn run(self, typed: &str) -> anyhow::Result<Exit> {
        let request = self.request(typed)?;
        if self.print_config {
            output::text(&request.config.to_toml())?;
            return Ok(Exit::Done);
        }
        let stop = interrupt::stop_flag("finishing this step, then saving")?;
        let bar = Bar::new();
        let outcome = run::train::train(&request, &bar, &stop);
        bar.finish();
        report(&request, &outcome?, self.json)
    }

    fn request(&self, typed: &str) -> anyhow::Result<TrainRequest> {
        if let Some(run) = &self.resume {
            return TrainRequest::resume(run);
        }
        let config = self.settings()?;
        let out = self.out.clone().unwrap_or_else(|| RunFolder::default_path(&config));
        let start = if self.force { Start::Replace } else { Start::New };
        Ok(TrainRequest { config, out, start, command: typed.to_owned() })
    }

    /// Defaults, file and flags.
    fn settings(&self) -> anyhow::Result<Config> {
        let mut config = match &self.config {
            Some(path) => Config::read(path)?,
            None => Config::default(),
        };
        self.apply(&mut config);
        for setting in &self.set {
            config = config.with_setting(setting)?;
        }
        let config = config.with_absolute_paths();
        config.validate()?;
        Ok(config)
    }

    fn apply(&self, config: &mut Config) {
        if self.quick {
            config.apply_quick();
        }
        let data = &mut config.data;
        if let Some(path) = &self.data {
            data.path = Some(path.clone());
            data.sequences.clone_from(&self.sequences);
        }
        if let Some(preset) = self.preset {
            data.preset = preset;
            data.path = None;
        }
        if let Some(Size { width, height }) = self.size {
            (data.width, data.height) = (width, height);
        }
        replace(&mut config.seed, self.seed);
        if let Some(loss) = self.loss {
            loss.apply(config);
        }
        if self.paper_schedule {
            config.use_paper_schedule();
        }
        replace(&mut config.train.steps, self.steps);
        replace(&mut config.train.batch, self.batch);
        replace(&mut config.train.learning_rate, self.learning_rate);
        replace(&mut config.nets.flow_weights, self.flow_weights.clone());
        replace(&mut config.nets.depth_weights, self.depth_weights.clone());
        replace(&mut config.nets.pose_weights, self.pose_weights.clone());
        if let Some(Stages(numbers)) = &self.stages {
            config.train.only_stages = Some(numbers.clone());
        }
    }
}

fn replace<V>(place: &mut V, value: Option<V>) {
    if let Some(value) = value {
        *place = value;
    }
}

fn report(request: &TrainRequest, outcome: &TrainOutcome, json: bool) -> anyhow::Result<Exit> {
    match outcome {
        TrainOutcome::Finished { metrics, checkpoint_hash, .. } if json => {
            let mut metrics = metrics.clone();
            metrics["checkpoint_hash"] = checkpoint_hash.as_str().into();
            output::json(&metrics)?;
        }
        TrainOutcome::Finished { table, report, checkpoint_hash, .. } => {
            let hash = format!("checkpoint {} ({checkpoint_hash})", RunFolder::new(&request.out).checkpoint().display());
            output::text(&format!("{}\n\nreport     {}\n{hash}\n", table.trim_end(), report.display()))?;
        }
        TrainOutcome::Interrupted { step } => {
            let resume = format!("dimode train --resume {}", request.out.display());
            eprintln_quietly(&format!("stopped after step {step}, everything is saved; go on with: {resume}"));
            return Ok(Exit::Interrupted);
        }
    }
    Ok(Exit::Done)
}

fn eprintln_quietly(line: &str) {
    use std::io::Write;
    // The exit code tells the same to whoever closed standard error.
    let _ = writeln!(std::io::stderr(), "{line}");
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use dimode_geometry::losses::LossOptions;

    use super::*;

    #[derive(Parser)]
    struct Alone {
        #[command(flatten)]
        args: TrainArgs,
    }

    fn settings(flags: &[&str]) -> anyhow::Result<Config> {
        Alone::try_parse_from(std::iter::once(&"train").chain(flags))?.args.settings()
    }

    #[test]
    fn flags_win_over_quick_and_quick_over_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("run.toml");
        std::fs::write(&file, "seed = 5\n[train]\nsteps = 77\nbatch = 3\nlearning_rate = 0.002\n").unwrap();
        let file = file.to_str().unwrap();
        let config = settings(&["--config", file]).unwrap();
        assert_eq!((config.seed, config.train.steps, config.train.batch), (5, 77, 3));
        let config = settings(&["--config", file, "--quick"]).unwrap();
        assert_eq!((config.seed, config.train.steps), (5, Config::quick().train.steps));
        assert_eq!(config.train.learning_rate, 0.002);
        let config = settings(&["--config", file, "--quick", "--steps", "9", "--seed", "6"]).unwrap();
        assert_eq!((config.seed, config.train.steps), (6, 9));
    }

    #[test]
    fn any_setting_can_be_set_by_name() {
        let config = settings(&["--set", "loss.geometric.planar=literal", "--set", "train.betas=[0.8, 0.9]"]).unwrap();
        assert_eq!(config.train.betas, [0.8, 0.9]);
        assert_eq!(config.loss.geometric.planar, dimode_geometry::losses::PlanarForm::Literal);
        assert!(settings(&["--set", "steps"]).is_err());
    }

    #[test]
    fn stages_and_forms_are_taken() {
        let config = settings(&["--stages", "1", "--loss", "dimode-literal", "--size", "96x64"]).unwrap();
        assert_eq!(config.train.only_stages, Some(vec![1]));
        assert_eq!(config.loss.geometric, LossOptions::literal());
        assert_eq!((config.data.width, config.data.height), (96, 64));
        assert_eq!(RunFolder::default_path(&config), PathBuf::from("runs/train-street-s1-stages1-dimode-literal"));
        assert!(settings(&["--stages", "4"]).unwrap_err().to_string().contains("train.only_stages"));
    }

    #[test]
    fn the_loss_of_the_flag_wins_over_the_file_and_single_settings_over_the_flag() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("run.toml");
        std::fs::write(&file, "[loss.geometric]\nplanar = \"robust\"\nkappa = 0.5\n").unwrap();
        let file = file.to_str().unwrap();
        assert_eq!(settings(&["--config", file, "--loss", "dimode"]).unwrap(), Config::default());
        assert_eq!(settings(&["--config", file, "--loss", "df-net"]).unwrap(), LossPreset::DfNet.config());
        let set = ["--loss", "dcpi", "--set", "train.stages.2.contextual=0.5"];
        let mut expected = LossPreset::Dcpi.config();
        expected.train.stages[1].contextual = 0.5;
        assert_eq!(settings(&set).unwrap(), expected);
        assert_eq!(settings(&["--set", "loss.preset=dcpi", set[2], set[3]]).unwrap(), expected);
        assert!(settings(&["--loss", "literal"]).is_err());
    }

    #[test]
    fn the_help_tells_the_true_defaults() {
        use clap::CommandFactory;
        let help = Alone::command().render_long_help().to_string();
        let Config { seed, data, train, .. } = Config::default();
        let size = format!("{}x{}", data.width, data.height);
        let defaults = [
            ("steps", train.steps.to_string()),
            ("batch", train.batch.to_string()),
            ("seed", seed.to_string()),
            ("learning-rate", train.learning_rate.to_string()),
            ("size", size),
        ];
        for (flag, value) in defaults {
            let text = &help[help.find(&format!("--{flag} <")).unwrap()..];
            let end = text[2..].find("\n      --").map_or(text.len(), |at| at + 2);
            assert!(text[..end].contains(&format!("[default: {value}]")), "--{flag}: {}", &text[..end]);
        }
    }

    #[test]
    fn resume_takes_no_other_settings() {
        assert!(settings(&["--resume", "x", "--steps", "3"]).is_err());
    }
}
