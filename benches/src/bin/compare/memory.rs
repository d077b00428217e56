//! Peak memory of some training steps, a fresh process for each side, and allocations in steady state.

use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result, ensure};
use dimode_autodiff::par;
use dimode_benches::ours::step::StepCase;
use dimode_benches::{Case, Inputs, machine};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::peer::{Allocator, scripts};
use super::tables::{Table, of_threads};

/// Steps of each process.
const STEPS: usize = 4;

/// The largest resident memory of one side.
#[derive(Clone, Debug, Serialize)]
pub struct Peak {
    /// What ran.
    pub case: String,
    /// Threads of either side.
    pub threads: usize,
    /// Who ran it.
    pub side: String,
    /// Mebibytes at the peak.
    pub peak: f64,
    /// Mebibytes before anything was built: the program and its libraries.
    pub start: f64,
}

/// The cases whose memory is measured.
pub fn cases() -> [StepCase; 4] {
    [StepCase::monodepth2(1), StepCase::monodepth2(4), StepCase::nano(4), StepCase::paper()]
}

const ALLOCATORS: [Allocator; 2] = [Allocator::Default, Allocator::Tuned];

fn of_peer(allocator: Allocator) -> String {
    format!("PyTorch {}", allocator.name())
}

/// The names of all sides.
#[cfg(test)]
pub fn sides() -> Vec<String> {
    std::iter::once(OURS.to_owned()).chain(ALLOCATORS.map(of_peer)).collect()
}

/// Takes some steps of a case in this process and prints the peak of its memory: what [`measure`] starts.
///
/// # Errors
/// When there is no such case or the system does not say.
pub fn run_here(index: usize, threads: usize) -> Result<()> {
    let cases = cases();
    let case = cases.get(index).context("no such case")?;
    let start = machine::memory("VmRSS");
    let mut ours = case.build(&Inputs::Drawn)?;
    par::with_threads(threads, || {
        for _ in 0..STEPS {
            ours.repetition("step");
        }
    });
    let [start, peak] = [start, machine::memory("VmHWM")].map(|x| x.context("the system does not say how much memory was used"));
    println!("{{\"start_kib\": {}, \"peak_kib\": {}}}", start?, peak?);
    Ok(())
}

/// Peaks of both sides, the peer's with both allocators.
///
/// # Errors
/// When a process fails.
pub fn measure(python: &Path, threads: usize, quick: bool, only: &dyn Fn(&str) -> bool) -> Result<Vec<Peak>> {
    let mut peaks = Vec::new();
    for (index, case) in cases().iter().enumerate().filter(|(i, case)| (!quick || *i != 1) && only(case.name())) {
        let mut push = |side: &str, command: &mut Command| -> Result<()> {
            let [start, peak] = of_process(command).with_context(|| format!("memory of {}, {side}", case.name()))?;
            eprintln!("  {} {threads}t, {side}: {peak:.0} MiB, {start:.0} of them at the start", case.name());
            peaks.push(Peak { case: case.name().into(), threads, side: side.into(), peak, start });
            Ok(())
        };
        let here = std::env::current_exe()?;
        push(OURS, Command::new(here).args(["--peak-memory-of", &index.to_string(), "--threads", &threads.to_string()]))?;
        for allocator in ALLOCATORS {
            let folder = tempfile::tempdir()?;
            let mut command = Command::new(python);
            allocator.apply(&mut command);
            command.arg(scripts().join("step.py")).arg(case.spec().to_string()).arg(folder.path()).arg(threads.to_string());
            push(&of_peer(allocator), &mut command)?;
        }
    }
    Ok(peaks)
}

/// Mebibytes at the start and at the peak.
fn of_process(command: &mut Command) -> Result<[f64; 2]> {
    let output = command.output()?;
    ensure!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let answer: Value = serde_json::from_slice(&output.stdout)?;
    let mib = |key: &str| answer[key].as_f64().map(|kib| kib / 1024.0).with_context(|| format!("no {key} in the answer"));
    Ok([mib("start_kib")?, mib("peak_kib")?])
}

/// The side that is not PyTorch.
pub const OURS: &str = "ours";

impl Peak {
    /// Our peak over this one, and the same beyond the start: `None` where ours was not measured.
    pub fn shares(&self, peaks: &[Self]) -> Option<[f64; 2]> {
        let same = |p: &&Self| p.case == self.case && p.threads == self.threads && p.side == OURS;
        let ours = peaks.iter().find(same)?;
        Some([ours.peak / self.peak, (ours.peak - ours.start) / (self.peak - self.start)])
    }
}

/// The peaks of some threads as a table.
pub fn table(peaks: &[Peak], threads: usize) -> Table {
    let heads = ["case", "side", "MiB", "ours / PyTorch", "beyond the start, MiB", "ours / PyTorch"];
    let title = format!("Peak memory of a training step, {} (VmHWM of a fresh process)", of_threads(threads));
    let mut table = Table::new(&title, &heads);
    for peak in peaks.iter().filter(|peak| peak.threads == threads) {
        let shares = peak.shares(peaks).filter(|_| peak.side != OURS);
        let [share, beyond] = [0, 1].map(|k| shares.map_or("-".to_owned(), |shares| format!("{:.2}", shares[k])));
        let [mib, more] = [peak.peak, peak.peak - peak.start].map(|x| format!("{x:.0}"));
        table.push(vec![peak.case.clone(), peak.side.clone(), mib, share, more, beyond]);
    }
    table
}

/// What one repetition takes from the heap in steady state.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Allocations {
    /// Name of the case.
    pub case: String,
    /// What of it.
    pub what: String,
    /// Threads.
    pub threads: usize,
    /// Repetitions that were counted.
    pub repetitions: usize,
    /// Bytes of all allocations of a repetition.
    pub bytes: Count,
    /// Number of allocations of a repetition.
    pub allocations: Count,
    /// Number of those of 64 KiB or more.
    pub large: Count,
}

/// What the repetitions showed.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Count {
    /// The middle of them.
    pub median: f64,
    /// The most in one of them.
    pub most: f64,
}

/// Runs the program that counts allocations, in the cases whose name contains `only`.
///
/// # Errors
/// When it cannot be built or fails.
pub fn allocations(threads: usize, only: &str) -> Result<Vec<Allocations>> {
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".to_owned());
    let manifest = concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml");
    let mut command = Command::new(cargo);
    command.args(["run", "--quiet", "--release", "--manifest-path", manifest, "--bin", "allocations", "--"]);
    let output = command.args([&threads.to_string(), only]).output().context("cannot run cargo")?;
    ensure!(output.status.success(), "allocations: {}", String::from_utf8_lossy(&output.stderr));
    Ok(serde_json::from_slice(&output.stdout)?)
}

/// The allocations of some threads as a table.
pub fn allocations_table(found: &[Allocations], threads: usize) -> Table {
    let heads = ["case", "repetitions", "allocations", "most", "KiB together", "most", "of 64 KiB or more", "most"];
    let title = format!("Heap allocations of one repetition in steady state, {}: median and most", of_threads(threads));
    let mut table = Table::new(&title, &heads);
    for a in found.iter().filter(|a| a.threads == threads) {
        let numbers = [(a.allocations, 1.0), (a.bytes, 1024.0), (a.large, 1.0)];
        let cells = numbers.iter().flat_map(|(count, unit)| [count.median, count.most].map(|x| format!("{:.0}", x / unit)));
        table.push([format!("{}, {}", a.case, a.what), a.repetitions.to_string()].into_iter().chain(cells).collect());
    }
    table
}
