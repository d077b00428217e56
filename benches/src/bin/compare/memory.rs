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
use super::tables::Table;

/// Steps of each process.
const STEPS: usize = 4;

/// The largest resident memory of one side.
#[derive(Clone, Debug, Serialize)]
pub struct Peak {
    /// What ran.
    pub case: String,
    /// Who ran it.
    pub side: String,
    /// Mebibytes at the peak.
    pub peak: f64,
    /// Mebibytes before anything was built: the program and its libraries.
    pub start: f64,
}

/// The cases whose memory is measured.
fn cases() -> [StepCase; 3] {
    [StepCase::monodepth2(1), StepCase::monodepth2(4), StepCase::nano(4)]
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
pub fn measure(python: &Path, threads: usize, quick: bool) -> Result<Vec<Peak>> {
    let mut peaks = Vec::new();
    for (index, case) in cases().iter().enumerate().filter(|(i, _)| !quick || *i != 1) {
        let mut push = |side: &str, command: &mut Command| -> Result<()> {
            let [start, peak] = of_process(command).with_context(|| format!("memory of {}, {side}", case.name()))?;
            eprintln!("  {}, {side}: {peak:.0} MiB, {start:.0} of them at the start", case.name());
            peaks.push(Peak { case: case.name().into(), side: side.into(), peak, start });
            Ok(())
        };
        let here = std::env::current_exe()?;
        push("ours", Command::new(here).args(["--peak-memory-of", &index.to_string(), "--threads", &threads.to_string()]))?;
        for allocator in [Allocator::Default, Allocator::Tuned] {
            let folder = tempfile::tempdir()?;
            let mut command = Command::new(python);
            allocator.apply(&mut command);
            command.arg(scripts().join("step.py")).arg(case.spec().to_string()).arg(folder.path()).arg(threads.to_string());
            push(&format!("PyTorch {}", allocator.name()), &mut command)?;
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

/// The peaks as a table.
pub fn table(peaks: &[Peak]) -> Table {
    let heads = ["case", "side", "MiB", "/ ours", "beyond the start, MiB", "/ ours"];
    let mut table = Table::new("Peak memory of a training step (VmHWM of a fresh process)", &heads);
    for peak in peaks {
        let ours = peaks.iter().find(|p| p.case == peak.case && p.side == "ours").unwrap_or(peak);
        let beyond = |p: &Peak| p.peak - p.start;
        table.push(vec![
            peak.case.clone(),
            peak.side.clone(),
            format!("{:.0}", peak.peak),
            format!("{:.2}", peak.peak / ours.peak),
            format!("{:.0}", beyond(peak)),
            format!("{:.2}", beyond(peak) / beyond(ours)),
        ]);
    }
    table
}

/// What one repetition takes from the heap in steady state.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Allocations {
    /// Name of the case.
    case: String,
    /// What of it.
    what: String,
    /// Bytes of all allocations.
    bytes: u64,
    /// Number of allocations.
    allocations: u64,
    /// Number of those of 64 KiB or more.
    large: u64,
}

/// Runs the program that counts allocations.
///
/// # Errors
/// When it cannot be built or fails.
pub fn allocations(threads: usize) -> Result<Vec<Allocations>> {
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".to_owned());
    let manifest = concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml");
    let mut command = Command::new(cargo);
    command.args(["run", "--quiet", "--release", "--manifest-path", manifest, "--bin", "allocations", "--"]);
    let output = command.arg(threads.to_string()).output().context("cannot run cargo")?;
    ensure!(output.status.success(), "allocations: {}", String::from_utf8_lossy(&output.stderr));
    Ok(serde_json::from_slice(&output.stdout)?)
}

/// The allocations as a table.
pub fn allocations_table(found: &[Allocations]) -> Table {
    let heads = ["case", "allocations", "KiB together", "of 64 KiB or more"];
    let mut table = Table::new("Heap allocations of one repetition in steady state (asked: none of 64 KiB or more)", &heads);
    for a in found {
        let cells = [
            format!("{}, {}", a.case, a.what),
            a.allocations.to_string(),
            format!("{:.0}", a.bytes as f64 / 1024.0),
            a.large.to_string(),
        ];
        table.push(cells.to_vec());
    }
    table
}
