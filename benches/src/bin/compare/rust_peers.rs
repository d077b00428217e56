//! Other Rust libraries: their program is built when it is asked for, and speaks as the one of PyTorch does.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, ensure};
use serde_json::{Value, json};

use dimode_benches::ours::conv::{ConvCase, SHAPES};
use dimode_benches::timing::geometric_mean;
use dimode_benches::{Case, Inputs, Ours};

use super::duel::{Effort, Peers, Row, Variant, duel};
use super::peer::{Allocator, Peer, scripts};
use super::tables::Table;

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

/// Compares all convolutions with the libraries; PyTorch writes the inputs.
///
/// # Errors
/// When the program cannot be built or numbers differ.
pub fn compare(effort: &Effort, folder: &Path, peers: &mut Peers, only: &dyn Fn(&str) -> bool, quick: bool) -> Result<Vec<Row>> {
    let program = program()?;
    let mut rows = Vec::new();
    for &threads in &effort.threads {
        let mut command = Command::new(&program);
        // Read once by the thread library that both of them use.
        command.env("RAYON_NUM_THREADS", threads.to_string());
        peers.insert(Allocator::RustPeers.name(), Peer::spawn(command)?);
        let effort = Effort { threads: vec![threads], ..effort.clone() };
        let mut variants = vec![Variant { allocator: Allocator::Tuned, settings: json!({"layout": "nchw"}) }];
        variants
            .extend(LIBRARIES.map(|library| Variant { allocator: Allocator::RustPeers, settings: json!({"library": library}) }));
        for case in SHAPES.into_iter().step_by(if quick { 5 } else { 1 }).filter(|case| only(case.name)) {
            let found = duel(&BothWays(case), &variants, &effort, folder, peers)?;
            // The goals for PyTorch look at its own comparison.
            rows.extend(found.into_iter().map(|row| Row { topic: "rust-peers".into(), ..row }));
        }
    }
    peers.remove(Allocator::RustPeers.name());
    Ok(rows)
}

/// For each shape the better of the libraries.
pub fn best_table(rows: &[Row]) -> Table {
    let heads = ["case", "threads", "best library", "time / ours"];
    let mut table = Table::new("Best of the Rust peers, forward and backward (asked: 4, aim 6, near the limit 10)", &heads);
    let theirs = || rows.iter().filter(|row| row.what == "forward_backward" && !row.variant.starts_with("nchw"));
    let mut keys: Vec<_> = theirs().map(|row| (row.case.clone(), row.threads)).collect();
    keys.dedup();
    let mut ratios = Vec::new();
    for (case, threads) in keys {
        let of_case = theirs().filter(|row| row.case == case && row.threads == threads);
        if let Some(best) = of_case.min_by(|a, b| a.theirs.total_cmp(&b.theirs)) {
            ratios.push(best.ratio());
            table.push(vec![case, threads.to_string(), best.variant.clone(), format!("{:.1}", best.ratio())]);
        }
    }
    if !ratios.is_empty() {
        table.push(vec![
            "**geometric mean**".into(),
            String::new(),
            String::new(),
            format!("**{:.1}**", geometric_mean(&ratios)),
        ]);
    }
    table
}
