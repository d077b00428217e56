//! Other Rust libraries: their program is built when it is asked for, and speaks as the one of PyTorch does.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, ensure};
use serde_json::{Value, json};

use dimode_benches::ours::conv::{ConvCase, SHAPES};
use dimode_benches::timing::{ends, geometric_mean};
use dimode_benches::{Case, Inputs, Ours};

use super::duel::{Row, Variant};
use super::peer::{Allocator, Peer, scripts};
use super::tables::{Table, of_threads, with_spread};

/// The libraries.
const LIBRARIES: [&str; 3] = ["candle", "burn-ndarray", "burn-flex"];

/// A convolution, forward and forward with both gradients: what all libraries offer.
struct BothWays(ConvCase);

impl Case for BothWays {
    fn topic(&self) -> &'static str {
        self.0.topic()
    }

    fn name(&self) -> &str {
        self.0.name
    }

    fn whats(&self) -> &'static [&'static str] {
        &["forward", "forward_backward"]
    }

    fn spec(&self) -> Value {
        self.0.spec()
    }

    fn build(&self, inputs: &Inputs) -> Result<Box<dyn Ours + Send>> {
        self.0.build(inputs)
    }
}

/// Builds their program.
///
/// # Errors
/// When cargo fails, for instance without a network at the first time.
fn program() -> Result<PathBuf> {
    let folder = scripts().join("rust");
    eprintln!("  building {} (some minutes at the first time)", folder.display());
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".to_owned());
    let mut command = Command::new(cargo);
    let target =
        std::env::var_os("CARGO_TARGET_DIR").map_or(folder.join("target"), |shared| Path::new(&shared).join("rust-peers"));
    command.args(["build", "--quiet", "--release", "--manifest-path"]).arg(folder.join("Cargo.toml"));
    let status = command.arg("--target-dir").arg(&target).status().context("cannot run cargo")?;
    ensure!(status.success(), "the Rust peers could not be built");
    Ok(target.join("release/rust-peers"))
}

/// The ways in which each case runs; PyTorch is there to write the inputs.
pub fn variants() -> Vec<Variant> {
    let libraries = LIBRARIES.map(|library| Variant { allocator: Allocator::RustPeers, settings: json!({"library": library}) });
    let mut variants = vec![Variant { allocator: Allocator::Tuned, settings: json!({"layout": "nchw"}) }];
    variants.extend(libraries);
    variants
}

/// All convolutions; some of them for a first look.
pub fn cases(quick: bool) -> Vec<Box<dyn Case>> {
    SHAPES.into_iter().step_by(if quick { 5 } else { 1 }).map(|case| Box::new(BothWays(case)) as Box<dyn Case>).collect()
}

/// Builds the libraries' program and starts it with a number of threads, which it reads once.
///
/// # Errors
/// When the program cannot be built or started.
pub fn start(threads: usize) -> Result<Peer> {
    let mut command = Command::new(program()?);
    command.env("RAYON_NUM_THREADS", threads.to_string());
    Peer::spawn(command)
}

/// For each shape the faster of the libraries, forward and backward.
pub fn best(rows: &[Row], threads: usize) -> Vec<&Row> {
    let theirs = |row: &&Row| row.threads == threads && row.what == "forward_backward" && is_library(row);
    let chosen: Vec<&Row> = rows.iter().filter(theirs).collect();
    let faster = |row: &&Row| !chosen.iter().any(|other| other.case == row.case && other.theirs < row.theirs);
    chosen.iter().copied().filter(faster).collect()
}

fn is_library(row: &Row) -> bool {
    LIBRARIES.iter().any(|library| row.variant.starts_with(library))
}

/// [`best`] as a table, with mean and worst.
pub fn best_table(rows: &[Row], threads: usize) -> Table {
    let title = format!("The faster of candle and burn, forward and backward, {}: its time / ours", of_threads(threads));
    let mut table = Table::new(&title, &["case", "faster library", "ours, ms", "time / ours"]);
    let found = best(rows, threads);
    for row in &found {
        table.push(vec![row.case.clone(), row.variant.clone(), format!("{:.3}", row.ours), with_spread(row)]);
    }
    let ratios: Vec<f64> = found.iter().map(|row| row.ratio()).collect();
    for (name, number) in [("geometric mean", geometric_mean(&ratios)), ("worst", ends(&ratios).0)] {
        if !ratios.is_empty() {
            table.push(vec![format!("**{name}**"), String::new(), String::new(), format!("**{number:.2}**")]);
        }
    }
    table
}
