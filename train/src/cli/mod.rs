//! The command line: one file per command, each parses, calls one function of [`crate::run`], and prints.

mod cost;
mod eval_depth;
mod eval_odometry;
mod failure;
mod infer;
mod interrupt;
mod options;
mod output;
mod pretrain;
mod pretrain_flow;
mod pretrain_pose;
mod synth;
mod train;
mod verify;
mod weights;

use std::ffi::OsString;
use std::process::ExitCode;

use clap::{Args, Parser, Subcommand};

use failure::Exit;

const LONG_ABOUT: &str = "\
Learns depth and camera motion from plain video, and shows what it learned.

Three networks (depth, motion, optical flow) are trained together on snippets of three frames, without any ground truth: \
a frame must look like its neighbour seen through the predicted depth and motion, and the flow between them must agree with \
both. Frames come from an embedded, procedural world, or from a folder of your own. The equations behind it are checked one by \
one.";

const EXAMPLES: &str = "\
Examples:
  dimode train --quick                      a first look in about two minutes
  dimode train                              embedded street world, default settings
  dimode train --data DIR --steps 2000      your own frames (dimode train --help tells how to lay them out)
  dimode eval depth --run runs/train-street-s1
  dimode infer --run runs/train-street-s1 --data DIR --out predictions
  dimode synth --preset handheld --worlds 2 --out worlds
  dimode verify                             every equation of the paper, with a verdict
  dimode cost                               parameters, multiply-accumulates, time and memory of every network
  dimode weights inspect encoder.pth        trained weights of others: what they are

Exit codes: 0 done, 1 failed, 2 wrong usage or configuration, 130 interrupted (train saves first).
All text about the work goes to standard error, results to standard output.";

#[derive(Debug, Parser)]
#[command(name = "dimode", version, about = summary(LONG_ABOUT), long_about = LONG_ABOUT, after_help = EXAMPLES)]
#[command(subcommand_required = true, arg_required_else_help = true, max_term_width = 110)]
struct Cli {
    #[command(flatten)]
    global: Global,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Args)]
struct Global {
    /// Threads to compute with [default: one per core]; the result has the same bits for any number
    #[arg(long, global = true, value_name = "N", value_parser = options::threads)]
    threads: Option<usize>,
}

// No doc comments on variants that hold arguments: clap would show them in place of the help that the arguments bring.
#[derive(Debug, Subcommand)]
enum Command {
    Train(Box<train::TrainArgs>),
    /// Score depth or trajectories against ground truth
    #[command(subcommand)]
    Eval(Eval),
    Infer(infer::InferArgs),
    Synth(synth::SynthArgs),
    /// Train a network on its own before the joint training
    #[command(subcommand)]
    Pretrain(Pretrain),
    Verify(verify::VerifyArgs),
    Cost(cost::CostArgs),
    /// Look at, convert and compare files of weights
    #[command(subcommand)]
    Weights(weights::Weights),
}

#[derive(Debug, Subcommand)]
enum Eval {
    Depth(eval_depth::EvalDepthArgs),
    Odometry(eval_odometry::EvalOdometryArgs),
}

#[derive(Debug, Subcommand)]
enum Pretrain {
    Flow(pretrain_flow::PretrainFlowArgs),
    Pose(pretrain_pose::PretrainPoseArgs),
}

/// The first sentence of a long help, for lists of commands and for `-h`.
fn summary(long: &'static str) -> &'static str {
    long.lines().next().unwrap_or(long).trim_end_matches('.')
}

/// Runs the command line of this process and gives its exit code.
pub fn main() -> ExitCode {
    run(std::env::args_os()).code()
}

fn run(args: impl IntoIterator<Item = OsString>) -> Exit {
    let args: Vec<OsString> = args.into_iter().collect();
    let cli = match Cli::try_parse_from(&args) {
        Ok(cli) => cli,
        Err(error) => {
            // A closed pipe behind `--help` is a normal end.
            let _ = error.print();
            return if error.use_stderr() { Exit::Usage } else { Exit::Done };
        }
    };
    prepare(&cli.global).and_then(|()| dispatch(cli.command, &typed(&args))).unwrap_or_else(|error| failure::tell(&error))
}

fn dispatch(command: Command, typed: &str) -> anyhow::Result<Exit> {
    match command {
        Command::Train(args) => args.run(typed),
        Command::Eval(Eval::Depth(args)) => args.run(),
        Command::Eval(Eval::Odometry(args)) => args.run(),
        Command::Infer(args) => args.run(),
        Command::Synth(args) => args.run(),
        Command::Pretrain(Pretrain::Flow(args)) => args.run(),
        Command::Pretrain(Pretrain::Pose(args)) => args.run(),
        Command::Verify(args) => args.run(),
        Command::Cost(args) => args.run(),
        Command::Weights(command) => command.run(),
    }
}

fn prepare(global: &Global) -> anyhow::Result<()> {
    let Some(threads) = global.threads else { return Ok(()) };
    let started = dimode_autodiff::par::set_threads(threads);
    started.map_err(|error| anyhow::anyhow!("the threads could not be started: {error}"))
}

/// The command as a shell would take it, for the report.
fn typed(args: &[OsString]) -> String {
    let quote = |arg: &OsString| {
        let arg = arg.to_string_lossy();
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=,:+".contains(c);
        if !arg.is_empty() && arg.chars().all(plain) { arg.into_owned() } else { format!("'{}'", arg.replace('\'', "'\\''")) }
    };
    let rest = args.iter().skip(1).map(quote);
    std::iter::once("dimode".to_owned()).chain(rest).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn the_description_of_the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn the_typed_command_can_be_pasted() {
        let args = ["/x/dimode", "train", "--data", "my frames", "--seed", "3"].map(OsString::from);
        assert_eq!(typed(&args), "dimode train --data 'my frames' --seed 3");
    }
}
