//! Ours and PyTorch side by side, in one run: the same inputs, the numbers compared first, then short rounds in turn.
//!
//! `compare --help` says what can be asked for, `benches/README.md` how it is measured.

mod agree;
mod duel;
mod goals;
mod memory;
mod peer;
mod rust_peers;
mod tables;
mod topics;

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::{env, fs};

use anyhow::{Context, Result};
use clap::Parser;
use dimode_benches::machine;
use serde_json::json;

use duel::{Effort, Peers, Row};
use peer::{Allocator, Peer};
use tables::Table;
use topics::Topic;

/// Times ours and PyTorch in turn on the same numbers.
#[derive(Parser)]
#[command(name = "compare")]
struct Arguments {
    /// What to compare; everything by default.
    topics: Vec<Topic>,
    /// Threads of both sides, one number after the other.
    #[arg(long, num_args = 1.., default_values_t = [2])]
    threads: Vec<usize>,
    /// Rounds of each comparison.
    #[arg(long, default_value_t = 7)]
    rounds: usize,
    /// Fewer cases, shorter and fewer rounds, nothing compiled: a first look.
    #[arg(long)]
    quick: bool,
    /// Leave out torch.compile, which takes a minute for each graph.
    #[arg(long)]
    no_compile: bool,
    /// Only cases whose name contains this.
    #[arg(long)]
    only: Option<String>,
    /// Also the Rust peers, which are built first (some minutes).
    #[arg(long)]
    rust_peers: bool,
    /// Write everything that was measured to this file.
    #[arg(long)]
    json: Option<PathBuf>,
    /// Write the tables to this file.
    #[arg(long)]
    markdown: Option<PathBuf>,
    /// Python with torch; else $DIMODE_PYTHON, else python3.
    #[arg(long)]
    python: Option<PathBuf>,
    /// Take some steps in this process and print its peak memory; used by `memory`.
    #[arg(long, hide = true)]
    peak_memory_of: Option<usize>,
}

impl Arguments {
    fn rounds(&self) -> usize {
        if self.quick { self.rounds.min(3) } else { self.rounds }
    }
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let outcome = match arguments.peak_memory_of {
        Some(case) => memory::run_here(case, arguments.threads[0]).map(|()| ExitCode::SUCCESS),
        None => run(&arguments),
    };
    outcome.unwrap_or_else(|error| {
        eprintln!("compare: {error:#}");
        ExitCode::FAILURE
    })
}

fn run(arguments: &Arguments) -> Result<ExitCode> {
    let python = arguments.python.clone().or_else(|| env::var_os("DIMODE_PYTHON").map(PathBuf::from));
    let python = python.unwrap_or_else(|| "python3".into());
    let mut peers = Peers::new();
    for allocator in [Allocator::Default, Allocator::Tuned] {
        match Peer::start(&python, allocator) {
            Ok(peer) => drop(peers.insert(allocator.name(), peer)),
            Err(error) => {
                eprintln!("compare: {error:#}\n{MISSING}");
                return Ok(ExitCode::from(2));
            }
        }
    }
    let chosen = topics::chosen(&arguments.topics, arguments.rust_peers);
    let report = Report { machine: machine_text(&peers, arguments), ..measure(arguments, &chosen, &python, &mut peers)? };
    let text = report.to_markdown();
    println!("{text}");
    if let Some(path) = &arguments.markdown {
        fs::write(path, &text).with_context(|| format!("cannot write {}", path.display()))?;
    }
    if let Some(path) = &arguments.json {
        let all = json!({
            "machine": report.machine,
            "rows": report.rows,
            "memory": report.peaks,
            "allocations": report.allocations,
            "shares": report.shares
        });
        fs::write(path, serde_json::to_string_pretty(&all)?).with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// What to do without PyTorch.
const MISSING: &str = "These comparisons need Python 3.10 or later with numpy and torch (CPU is enough):
    python3 -m venv torch-env
    torch-env/bin/pip install numpy torch --index-url https://download.pytorch.org/whl/cpu --extra-index-url https://pypi.org/simple
    cargo run --release -p dimode-benches --bin compare -- --python torch-env/bin/python
(or set DIMODE_PYTHON). Everything else in benches/ runs without.";

/// Everything that a run measured.
#[derive(Default)]
struct Report {
    machine: String,
    tables: Vec<Table>,
    rows: Vec<Row>,
    peaks: Vec<memory::Peak>,
    allocations: Vec<memory::Allocations>,
    shares: Vec<topics::Share>,
}

impl Report {
    fn to_markdown(&self) -> String {
        let mut out = format!("{}\n", self.machine);
        for table in self.tables.iter().filter(|table| !table.is_empty()) {
            let _ = write!(out, "\n{}", table.to_markdown());
        }
        out
    }
}

fn measure(arguments: &Arguments, chosen: &[Topic], python: &Path, peers: &mut Peers) -> Result<Report> {
    let seconds = if arguments.quick { 0.03 } else { 0.1 };
    let effort = Effort { threads: arguments.threads.clone(), rounds: arguments.rounds(), seconds };
    let folder = tempfile::tempdir()?;
    let only = |name: &str| arguments.only.as_ref().is_none_or(|part| name.contains(part.as_str()));
    let mut report = Report::default();
    for &topic in chosen {
        eprintln!("{}", topic.title());
        let mut rows = Vec::new();
        for case in topic.cases(arguments.quick).iter().filter(|case| only(case.name())) {
            let variants = topic.variants(!arguments.quick && !arguments.no_compile);
            rows.extend(duel::duel(case.as_ref(), &variants, &effort, folder.path(), peers)?);
        }
        if topic == Topic::RustPeers {
            rows = rust_peers::compare(&effort, folder.path(), peers, &only, arguments.quick)?;
            report.tables.push(rust_peers::best_table(&rows));
        }
        report.tables.extend(tables::of_rows(topic.title(), &rows));
        report.rows.extend(rows);
        match topic {
            Topic::Memory => {
                report.peaks = memory::measure(python, arguments.threads[0], arguments.quick)?;
                report.tables.push(memory::table(&report.peaks));
            }
            Topic::Allocations => {
                report.allocations = memory::allocations(arguments.threads[0])?;
                report.tables.push(memory::allocations_table(&report.allocations));
            }
            Topic::Peak => {
                report.shares = topics::shares(&arguments.threads)?;
                report.tables.push(topics::shares_table(&report.shares));
            }
            _ => {}
        }
    }
    for &threads in &arguments.threads {
        report.tables.insert(0, goals::table(&report.rows, threads));
    }
    Ok(report)
}

fn machine_text(peers: &Peers, arguments: &Arguments) -> String {
    let version = peers.values().next().map_or("?", |peer| peer.version.as_str());
    let load = machine::load_average().map_or("?".to_owned(), |load| format!("{load:.1}"));
    format!(
        "{} ({}), load average {load}; PyTorch {version}; {} rounds, threads {:?}; numbers agreed before anything was timed.\n",
        machine::processor(),
        machine::instructions(),
        arguments.rounds(),
        arguments.threads
    )
}
