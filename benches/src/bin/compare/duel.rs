//! Short rounds of ours and theirs in turn.

use std::collections::HashMap;
use std::path::Path;

use anyhow::{Context, Result};
use dimode_autodiff::par;
use dimode_benches::timing::{ends, measure, median};
use dimode_benches::{Case, Inputs, Ours};
use serde::Serialize;
use serde_json::{Value, json};

use super::agree::agree;
use super::peer::{Allocator, Peer};

/// One way in which the peer runs a case.
#[derive(Clone, Debug)]
pub struct Variant {
    /// Process that runs it.
    pub allocator: Allocator,
    /// Settings that its module reads: `layout` or `mode`.
    pub settings: Value,
}

impl Variant {
    /// Name in tables, for instance `channels_last tuned`.
    pub fn name(&self) -> String {
        let settings: Vec<_> = self.settings.as_object().into_iter().flat_map(|map| map.values()).map(text).collect();
        format!("{} {}", settings.join(" "), self.allocator.name())
    }
}

fn text(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

/// How long and how often.
#[derive(Clone, Debug)]
pub struct Effort {
    /// Threads of both sides, one after the other.
    pub threads: Vec<usize>,
    /// Rounds of each comparison.
    pub rounds: usize,
    /// Seconds of one side in a round.
    pub seconds: f64,
}

/// One comparison: the same computation here and there.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Topic that it was asked for, by its name on the command line.
    pub topic: String,
    /// Name of the case.
    pub case: String,
    /// What of it was timed.
    pub what: String,
    /// How the peer ran it.
    pub variant: String,
    /// Threads of both sides.
    pub threads: usize,
    /// Our time, median over the rounds, milliseconds.
    pub ours: f64,
    /// The peer's time, likewise.
    pub theirs: f64,
    /// Their time over ours, round by round.
    pub ratios: Vec<f64>,
    /// Largest difference of the numbers as a share of what is accepted.
    pub difference: f64,
}

impl Row {
    /// Whether both sides computed the same: without that the times mean nothing.
    pub fn agrees(&self) -> bool {
        self.difference <= 1.0
    }

    /// The median of the ratios.
    pub fn ratio(&self) -> f64 {
        median(&self.ratios)
    }

    /// The smallest and largest ratio.
    pub fn spread(&self) -> (f64, f64) {
        ends(&self.ratios)
    }
}

/// The running peers.
pub type Peers = HashMap<&'static str, Peer>;

/// What came of a case.
#[derive(Debug, Default)]
pub struct Outcome {
    /// The comparisons.
    pub rows: Vec<Row>,
    /// Variants that the peer could not run, with the reason.
    pub left_out: Vec<String>,
    /// Variants whose numbers differ, with the numbers.
    pub differing: Vec<String>,
}

/// Builds a case on both sides, compares the numbers, then lets both run in turn. Variants that the peer cannot run are left out
/// and told; those whose numbers differ are timed all the same, and marked.
///
/// # Errors
/// When the peer is gone, or an input is missing.
pub fn duel(
    topic: &str,
    case: &dyn Case,
    variants: &[Variant],
    effort: &Effort,
    folder: &Path,
    peers: &mut Peers,
) -> Result<Outcome> {
    for peer in peers.values_mut() {
        peer.ask(&json!({"do": "forget"}))?;
    }
    let (mut built, mut outcome) = (Vec::new(), Outcome::default());
    let most = effort.threads.iter().copied().max().unwrap_or(1);
    for variant in variants {
        let key = variant.name();
        let peer = peers.get_mut(variant.allocator.name()).context("a peer for each allocator")?;
        let request = json!({
            "do": "build", "topic": case.topic(), "case": case.spec(), "variant": variant.settings, "key": key,
            "threads": most, "dir": folder
        });
        match peer.ask(&request) {
            Ok(answer) => built.push((variant, key, answer["values"].clone())),
            // One that has stopped cannot run the others either.
            Err(error) if peer.has_stopped() => return Err(error.context(format!("{}, {key}", case.name()))),
            Err(error) => {
                outcome.left_out.push(format!("{}, {key}: {error:#}", case.name()));
                eprintln!("  left out: {}, {key}: {error:#}", case.name());
            }
        }
    }
    if built.is_empty() {
        return Ok(outcome);
    }
    let of_case = folder.join(case.name());
    let mut ours = case.build(&Inputs::Folder(of_case.join("inputs")))?;
    let results = par::with_threads(most, || ours.results());
    let mut differences = Vec::new();
    for (_, key, values) in &built {
        let found = agree(&results, &of_case.join(key), values);
        if !found.refused.is_empty() {
            let text = format!("{}, {key}: {}", case.name(), found.refused.join(", "));
            eprintln!("  differs: {text}");
            outcome.differing.push(text);
        }
        differences.push(found.difference);
    }
    for &threads in &effort.threads {
        for &what in case.whats() {
            // One pool of threads for all rounds, so that what threads keep is kept, as in training.
            let times = par::with_threads(threads, || rounds(ours.as_mut(), &built, what, threads, effort, peers))?;
            for (((variant, ..), times), &difference) in built.iter().zip(times).zip(&differences) {
                let [own, other] = [0, 1].map(|k| times.iter().map(|t| t[k]).collect::<Vec<_>>());
                let row = Row {
                    topic: topic.into(),
                    case: case.name().into(),
                    what: what.into(),
                    variant: variant.name(),
                    threads,
                    ours: median(&own),
                    theirs: median(&other),
                    ratios: times.iter().map(|[own, other]| other / own).collect(),
                    difference,
                };
                tell(&row);
                outcome.rows.push(row);
            }
        }
    }
    std::fs::remove_dir_all(of_case)?;
    Ok(outcome)
}

fn tell(row: &Row) {
    let ((low, high), ratio) = (row.spread(), row.ratio());
    let mark = if row.agrees() { "" } else { "  differs" };
    eprintln!(
        "  {} {} {}t {:22} ours {:9.3} ms  theirs {:9.3} ms  ratio {ratio:6.2} ({low:.2}..{high:.2}){mark}",
        row.case, row.what, row.threads, row.variant, row.ours, row.theirs
    );
}

/// Medians of ours and theirs, milliseconds, for each variant and round. Our time is taken before and after each variant's, so
/// that a machine that grows slower does not favour a side.
fn rounds(
    ours: &mut (dyn Ours + Send),
    built: &[(&Variant, String, Value)],
    what: &str,
    threads: usize,
    effort: &Effort,
    peers: &mut Peers,
) -> Result<Vec<Vec<[f64; 2]>>> {
    let mut times = vec![Vec::new(); built.len()];
    for _ in 0..effort.rounds {
        let mut before = median(&measure(ours, what, effort.seconds));
        for ((variant, key, _), times) in built.iter().zip(&mut times) {
            let peer = peers.get_mut(variant.allocator.name()).context("a peer for each allocator")?;
            let theirs = median(&peer.time(key, what, threads, effort.seconds)?);
            peer.settle();
            let after = median(&measure(ours, what, effort.seconds));
            times.push([0.5 * (before + after), theirs]);
            before = after;
        }
    }
    Ok(times)
}
