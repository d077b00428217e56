//! Ours and PyTorch side by side, in one run: the same inputs, the numbers compared first, then short rounds in turn.
//!
//! `compare --help` says what can be asked for, `benches/README.md` how it is measured.

mod agree;
mod duel;
mod goals;
mod memory;
mod peer;
mod report;
mod rust_peers;
mod tables;
mod topics;

use std::env;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Result;
use clap::Parser;
use dimode_benches::machine;

use duel::{Effort, Peers};
use peer::{Allocator, Peer};
use report::Report;
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
    /// Write everything that was measured to this file, after every topic.
    #[arg(long)]
    json: Option<PathBuf>,
    /// Write the tables to this file, after every topic.
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

    /// Whether some of the cases will do: a first look, and none was asked for by name.
    fn takes_some(&self) -> bool {
        self.quick && self.only.is_none()
    }

    /// Whether a case of this name was asked for.
    fn wants(&self, name: &str) -> bool {
        self.only.as_ref().is_none_or(|part| name.contains(part.as_str()))
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
    let topics = topics::chosen(&arguments.topics, arguments.rust_peers);
    let threads = arguments.threads.clone();
    let mut report = Report { machine: machine_text(&peers, arguments), threads, topics, ..Report::default() };
    let outcome = measure(arguments, &python, &mut peers, &mut report);
    println!("{}", report.to_markdown());
    outcome?;
    if let Some(part) = arguments.only.as_ref().filter(|_| report.is_empty()) {
        let cases = report.topics.iter().flat_map(|topic| topic.cases(false));
        let names: Vec<_> = cases.map(|case| format!("\n    {}", case.name())).collect();
        eprintln!("compare: no case of these topics has '{part}' in its name; among their names are{}", names.concat());
        return Ok(ExitCode::from(2));
    }
    for text in &report.differing {
        eprintln!("compare: numbers differ: {text}");
    }
    Ok(if report.differing.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// What to do without PyTorch.
const MISSING: &str = "These comparisons need Python 3.10 or later with numpy and torch (CPU is enough):
    python3 -m venv torch-env
    torch-env/bin/pip install numpy torch --index-url https://download.pytorch.org/whl/cpu --extra-index-url https://pypi.org/simple
    cargo run --release -p dimode-benches --bin compare -- --python torch-env/bin/python
(or set DIMODE_PYTHON). Everything else in benches/ runs without.";

/// Measures the topics of the report one after the other and writes it after each, also after one that failed.
fn measure(arguments: &Arguments, python: &Path, peers: &mut Peers, report: &mut Report) -> Result<()> {
    for topic in report.topics.clone() {
        eprintln!("{}", topic.title());
        let outcome = measure_topic(arguments, topic, python, peers, report);
        report.save(arguments.markdown.as_deref(), arguments.json.as_deref())?;
        outcome?;
    }
    Ok(())
}

fn measure_topic(arguments: &Arguments, topic: Topic, python: &Path, peers: &mut Peers, report: &mut Report) -> Result<()> {
    let seconds = if arguments.quick { 0.03 } else { 0.1 };
    let effort = Effort { threads: arguments.threads.clone(), rounds: arguments.rounds(), seconds };
    let folder = tempfile::tempdir()?;
    let only = |name: &str| arguments.wants(name);
    match topic {
        Topic::Memory => {
            for &threads in &arguments.threads {
                report.peaks.extend(memory::measure(python, threads, arguments.takes_some(), &only)?);
            }
        }
        Topic::Allocations => {
            for &threads in &arguments.threads {
                report.allocations.extend(memory::allocations(threads, arguments.only.as_deref().unwrap_or_default())?);
            }
        }
        Topic::Peak => report.shares = topics::shares(&arguments.threads, &only)?,
        Topic::RustPeers => {
            let variants = rust_peers::variants();
            for &threads in &arguments.threads {
                peers.insert(Allocator::RustPeers.name(), rust_peers::start(threads)?);
                let effort = Effort { threads: vec![threads], ..effort.clone() };
                for case in rust_peers::cases(arguments.takes_some()).iter().filter(|case| only(case.name())) {
                    report.add(duel::duel(&topic.key(), case.as_ref(), &variants, &effort, folder.path(), peers)?);
                }
                peers.remove(Allocator::RustPeers.name());
            }
        }
        _ => {
            let variants = topic.variants(!arguments.quick && !arguments.no_compile);
            for case in topic.cases(arguments.takes_some()).iter().filter(|case| only(case.name())) {
                report.add(duel::duel(&topic.key(), case.as_ref(), &variants, &effort, folder.path(), peers)?);
            }
        }
    }
    Ok(())
}

fn machine_text(peers: &Peers, arguments: &Arguments) -> String {
    let version = peers.values().next().map_or("?", |peer| peer.version.as_str());
    let load = machine::load_average().map_or("?".to_owned(), |load| format!("{load:.1}"));
    format!(
        "{} ({}), load average {load}; PyTorch {version}; {} rounds, threads {:?}; numbers compared before anything was timed.\n",
        machine::processor(),
        machine::instructions(),
        arguments.rounds(),
        arguments.threads
    )
}
