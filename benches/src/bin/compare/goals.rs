//! What is asked for beside what was measured.

use dimode_benches::Case;
use dimode_benches::ours::conv::SHAPES;
use dimode_benches::timing::{ends, geometric_mean};
use serde_json::{Value, json};

use super::duel::Row;
use super::memory::OURS;
use super::report::Report;
use super::rust_peers;
use super::tables::{Table, of_threads};

/// One goal, and what would be near the limit of the machine; `None` where nothing is asked and the number only explains.
struct Goal {
    name: &'static str,
    goal: Option<f64>,
    aim: Option<f64>,
    source: Source,
}

/// Where its number comes from.
enum Source {
    /// The ratio of one comparison: topic, case, what of it, variant of the peer.
    Ratio([&'static str; 4]),
    /// A number of the ratios of all dense convolutions: passes, variant.
    Dense(&'static [&'static str], &'static str, fn(&[f64]) -> f64),
    /// All passes of the dilated depth-wise convolution together, theirs over ours.
    Dilated(&'static str),
    /// A number of the ratios to the faster Rust library.
    RustPeers(fn(&[f64]) -> f64),
    /// Share of the multiply-add peak of a case; whether of the operations that were executed.
    Share(&'static str, bool),
    /// Our time on one thread over that on more: topic and case.
    Threads(&'static str, &'static str),
    /// Large allocations of a step of a case, the most that were seen.
    Allocations(&'static str),
    /// Our peak memory over PyTorch's as users start it; whether beyond the start.
    Memory(&'static str, bool),
}
use Source::{Allocations, Dense, Dilated, Memory, Ratio, RustPeers, Share, Threads};

const fn goal(name: &'static str, goal: f64, aim: f64, source: Source) -> Goal {
    Goal { name, goal: Some(goal), aim: Some(aim), source }
}

const fn told(name: &'static str, source: Source) -> Goal {
    Goal { name, goal: None, aim: None, source }
}

const FORWARD: &[&str] = &["forward"];
const DATA: &[&str] = &["backward_data"];
const WEIGHT: &[&str] = &["backward_weight"];
const BACKWARD: &[&str] = &["backward_data", "backward_weight"];
const LOSS: [&str; 2] = ["loss core 640x192 b1", "loss core 640x192 b4"];
const STEP: [&str; 2] = ["step width 64 640x192 b1", "step width 64 640x192 b4"];
const NANO: &str = "step width 16 192x64 b4";
const PAPER: &str = "step lite-mono, resnet18, raft-small 640x192 b1";
const ENCODER: &str = "encoder width 64 640x192 b1";

/// The goals; ratios are the peer's time over ours.
#[rustfmt::skip]
const GOALS: [Goal; 38] = [
    goal("loss core b1 / eager", 20.0, 40.0, Ratio(["loss", LOSS[0], "all", "eager default"])),
    goal("loss core b1 / compiled", 5.0, 10.0, Ratio(["loss", LOSS[0], "all", "compile tuned"])),
    goal("loss core b4 / eager", 20.0, 40.0, Ratio(["loss", LOSS[1], "all", "eager default"])),
    goal("loss core b4 / compiled", 5.0, 10.0, Ratio(["loss", LOSS[1], "all", "compile tuned"])),
    goal("geometric losses b1 / eager", 12.0, 25.0, Ratio(["loss", LOSS[0], "geom", "eager default"])),
    goal("geometric losses b1 / compiled", 5.0, 10.0, Ratio(["loss", LOSS[0], "geom", "compile tuned"])),
    goal("geometric losses b4 / eager", 12.0, 25.0, Ratio(["loss", LOSS[1], "geom", "eager default"])),
    goal("geometric losses b4 / compiled", 5.0, 10.0, Ratio(["loss", LOSS[1], "geom", "compile tuned"])),
    goal("14 convolutions forward, mean / nchw tuned", 1.2, 1.5, Dense(FORWARD, "nchw tuned", geometric_mean)),
    goal("the same / channels-last tuned", 0.9, 1.1, Dense(FORWARD, "channels_last tuned", geometric_mean)),
    goal("the worst of them / nchw tuned", 0.75, 1.0, Dense(FORWARD, "nchw tuned", worst)),
    goal("the same backward, data and weight together / nchw tuned", 1.15, 1.4, Dense(BACKWARD, "nchw tuned", geometric_mean)),
    told("of them data", Dense(DATA, "nchw tuned", geometric_mean)),
    told("of them weight", Dense(WEIGHT, "nchw tuned", geometric_mean)),
    goal("depth-wise dilated, all three passes / nchw default", 9.0, 15.0, Dilated("nchw default")),
    goal("the same / nchw tuned", 9.0, 15.0, Dilated("nchw tuned")),
    goal("convolution both ways / faster Rust library, worst shape", 6.0, 10.0, RustPeers(worst)),
    told("the same, geometric mean", RustPeers(geometric_mean)),
    goal("3x3 128-128 24x80, share of the peak, as defined", 0.55, 0.75, Share("3x3 128-128 24x80", false)),
    goal("the same, multiplications executed", 0.55, 0.75, Share("3x3 128-128 24x80", true)),
    goal("the same with taps apart: the direct kernel", 0.55, 0.75, Share("3x3 dilation 2 128-128 24x80", true)),
    goal("ResNet-18 encoder b1 / eager default", 1.0, 1.5, Ratio(["encoder", ENCODER, "forward_backward", "nchw default"])),
    goal("Monodepth2 step 640x192 b1 / eager default", 2.0, 3.5, Ratio(["step", STEP[0], "step", "nchw default"])),
    goal("Monodepth2 step 640x192 b4 / eager default", 2.0, 3.5, Ratio(["step", STEP[1], "step", "nchw default"])),
    goal("nano step 192x64 b4 / eager default", 6.0, 12.0, Ratio(["step", NANO, "step", "nchw default"])),
    goal("nano step 192x64 b4 / eager tuned", 4.5, 9.0, Ratio(["step", NANO, "step", "nchw tuned"])),
    Goal { name: "Monodepth2 step b1, one thread / this", goal: Some(1.7), aim: None, source: Threads("step", STEP[0]) },
    Goal { name: "Monodepth2 step b4, one thread / this", goal: Some(1.7), aim: None, source: Threads("step", STEP[1]) },
    Goal { name: "nano step b4, one thread / this", goal: Some(1.7), aim: None, source: Threads("step", NANO) },
    goal("allocations of 64 KiB or more, Monodepth2 step b1, most", 0.0, 0.0, Allocations(STEP[0])),
    goal("allocations of 64 KiB or more, nano step b4, most", 0.0, 0.0, Allocations(NANO)),
    goal("peak memory, Monodepth2 step b1, ours / PyTorch default", 0.6, 0.4, Memory(STEP[0], false)),
    goal("the same beyond the start: without program and libraries", 0.6, 0.4, Memory(STEP[0], true)),
    goal("peak memory, Monodepth2 step b4, ours / PyTorch default", 0.6, 0.4, Memory(STEP[1], false)),
    goal("the same beyond the start, b4", 0.6, 0.4, Memory(STEP[1], true)),
    told("step of Lite-Mono, ResNet-18, RAFT small, b1 / eager default", Ratio(["step", PAPER, "step", "nchw default"])),
    told("its peak memory, ours / PyTorch default", Memory(PAPER, false)),
    told("Monodepth2 step 640x192 b1 / channels-last tuned", Ratio(["step", STEP[0], "step", "channels_last tuned"])),
];

/// A number, and why it may not be judged.
#[derive(Debug)]
struct Measured {
    value: f64,
    doubt: Option<String>,
}

impl Measured {
    fn sure(value: f64) -> Self {
        Self { value, doubt: None }
    }

    /// Of several rows, of which all should be there.
    fn of(rows: &[&Row], expected: usize, value: f64) -> Self {
        let doubt = if !rows.iter().all(|row| row.agrees()) {
            Some("numbers differ".to_owned())
        } else {
            (rows.len() < expected).then(|| format!("{} of {expected}", rows.len()))
        };
        Self { value, doubt }
    }
}

impl Goal {
    fn less_is_better(&self) -> bool {
        matches!(self.source, Allocations(_) | Memory(..))
    }

    fn verdict(&self, measured: &Measured) -> String {
        if let Some(doubt) = &measured.doubt {
            return doubt.clone();
        }
        let reached = |asked: f64| if self.less_is_better() { measured.value <= asked } else { measured.value >= asked };
        match (self.goal, self.aim) {
            (_, Some(aim)) if reached(aim) => "met, and the aim",
            (Some(goal), _) if reached(goal) => "met",
            (Some(_), _) => "not met",
            (None, _) => "-",
        }
        .to_owned()
    }

    fn text(&self, value: f64) -> String {
        match self.source {
            Share(..) => format!("{:.0} %", 100.0 * value),
            Allocations(_) => format!("{value:.0}"),
            _ => format!("{value:.2}"),
        }
    }

    fn measured(&self, report: &Report, threads: usize) -> Option<Measured> {
        let rows: Vec<&Row> = report.rows.iter().filter(|row| row.threads == threads).collect();
        match self.source {
            Ratio([topic, case, what, variant]) => {
                let wanted = |row: &&&Row| row.topic == topic && row.case == case && row.what == what && row.variant == variant;
                rows.iter().find(wanted).map(|row| Measured::of(&[*row], 1, row.ratio()))
            }
            Dense(passes, variant, number) => {
                let wanted = |row: &&Row| row.topic == "conv" && passes.contains(&row.what.as_str()) && row.variant == variant;
                let chosen: Vec<&Row> = rows.into_iter().filter(wanted).collect();
                let dense = SHAPES.iter().filter(|case| !case.is_depthwise());
                let expected = dense.flat_map(|case| case.whats()).filter(|what| passes.contains(what)).count();
                let ratios: Vec<f64> = chosen.iter().map(|row| row.ratio()).collect();
                (!ratios.is_empty()).then(|| Measured::of(&chosen, expected, number(&ratios)))
            }
            Dilated(variant) => {
                let wanted = |row: &&Row| row.topic == "depthwise" && row.case.contains("dilation 2") && row.variant == variant;
                let chosen: Vec<&Row> = rows.into_iter().filter(wanted).collect();
                let (ours, theirs) = chosen.iter().fold((0.0, 0.0), |(o, t), row| (o + row.ours, t + row.theirs));
                (ours > 0.0).then(|| Measured::of(&chosen, 3, theirs / ours))
            }
            RustPeers(number) => {
                let chosen = rust_peers::best(&report.rows, threads);
                let ratios: Vec<f64> = chosen.iter().map(|row| row.ratio()).collect();
                (!ratios.is_empty()).then(|| Measured::of(&chosen, SHAPES.len(), number(&ratios)))
            }
            Share(case, executed) => {
                let share = report.shares.iter().find(|share| share.case == case && share.threads == threads)?;
                Some(Measured::sure(if executed { share.executed } else { share.defined } / share.peak))
            }
            Threads(topic, case) => {
                let ours = |threads: usize| {
                    let wanted = |row: &&Row| row.topic == topic && row.case == case && row.threads == threads;
                    report.rows.iter().find(wanted).map(|row| row.ours)
                };
                // Two threads are asked for.
                (threads == 2).then(|| Some(Measured::sure(ours(1)? / ours(2)?)))?
            }
            Allocations(case) => {
                let wanted = |a: &&super::memory::Allocations| a.case == case && a.what == "step" && a.threads == threads;
                report.allocations.iter().find(wanted).map(|a| Measured::sure(a.large.most))
            }
            Memory(case, beyond) => {
                let peaks = || report.peaks.iter().filter(|peak| peak.case == case && peak.threads == threads);
                let theirs = peaks().find(|peak| peak.side != OURS && peak.side.ends_with("default"))?;
                theirs.shares(&report.peaks).map(|shares| Measured::sure(shares[usize::from(beyond)]))
            }
        }
    }
}

/// All goals in one table; empty when nothing of it was measured.
pub fn table(report: &Report) -> Table {
    let mut heads = vec!["item".to_owned(), "goal".to_owned(), "aim".to_owned()];
    heads.extend(report.threads.iter().flat_map(|&threads| [of_threads(threads), "verdict".to_owned()]));
    let heads: Vec<&str> = heads.iter().map(String::as_str).collect();
    let mut table = Table::new("Goals and aims near the limit; ratios are the time of the peer / ours", &heads);
    let found = |goal: &Goal| report.threads.iter().map(|&threads| goal.measured(report, threads)).collect::<Vec<_>>();
    let found: Vec<_> = GOALS.iter().map(|goal| (goal, found(goal))).collect();
    if !found.iter().flat_map(|(_, found)| found).any(Option::is_some) {
        return table;
    }
    for (goal, found) in found {
        let asked = [goal.goal, goal.aim].map(|x| x.map_or("-".to_owned(), |x| goal.text(x)));
        let mut cells = vec![goal.name.to_owned()];
        cells.extend(asked);
        for measured in found {
            cells.extend(match measured {
                Some(measured) => [goal.text(measured.value), goal.verdict(&measured)],
                None => ["-".to_owned(), "not measured".to_owned()],
            });
        }
        table.push(cells);
    }
    table
}

/// The goals that were measured.
pub fn to_json(report: &Report) -> Value {
    let each = |goal: &Goal| -> Vec<Value> {
        let measured = report.threads.iter().filter_map(|&threads| Some((threads, goal.measured(report, threads)?)));
        let entry = |(threads, measured): (usize, Measured)| {
            json!({
                "item": goal.name, "goal": goal.goal, "aim": goal.aim, "threads": threads, "measured": measured.value,
                "verdict": goal.verdict(&measured)
            })
        };
        measured.map(entry).collect()
    };
    GOALS.iter().flat_map(each).collect()
}

fn worst(ratios: &[f64]) -> f64 {
    ends(ratios).0
}

#[cfg(test)]
mod tests {
    use dimode_benches::ours::counted;

    use super::super::memory::{self, Count, Peak};
    use super::super::topics::{self, Topic};
    use super::*;

    const THREADS: [usize; 2] = [1, 2];

    /// A report of everything that `compare all --threads 1 2 --rust-peers` asks for, every ratio 2.
    fn full() -> Report {
        let mut report = Report { threads: THREADS.to_vec(), topics: topics::chosen(&[], true), ..Report::default() };
        for &topic in &report.topics {
            let rust = topic == Topic::RustPeers;
            let cases = if rust { rust_peers::cases(false) } else { topic.cases(false) };
            let variants = if rust { rust_peers::variants() } else { topic.variants(true) };
            for (threads, case) in THREADS.into_iter().flat_map(|threads| cases.iter().map(move |case| (threads, case))) {
                for (what, variant) in case.whats().iter().flat_map(|what| variants.iter().map(move |v| (what, v))) {
                    report.rows.push(Row {
                        topic: topic.key(),
                        case: case.name().into(),
                        what: (*what).into(),
                        variant: variant.name(),
                        threads,
                        ours: 1.0,
                        theirs: 2.0,
                        ratios: vec![2.0],
                        difference: 0.5,
                    });
                }
            }
        }
        for threads in THREADS {
            for case in topics::share_cases() {
                let (case, winograd) = (case.name.into(), false);
                report.shares.push(topics::Share { case, threads, winograd, defined: 1.0, executed: 1.0, peak: 2.0 });
            }
            for case in memory::cases() {
                for side in memory::sides() {
                    report.peaks.push(Peak { case: case.name().into(), threads, side, peak: 3.0, start: 1.0 });
                }
            }
            for (case, what) in counted() {
                let [bytes, allocations, large] = [Count { median: 0.0, most: 0.0 }; 3];
                let case = case.name().to_owned();
                report.allocations.push(memory::Allocations {
                    case,
                    what: what.into(),
                    threads,
                    repetitions: 20,
                    bytes,
                    allocations,
                    large,
                });
            }
        }
        report
    }

    #[test]
    fn every_goal_finds_its_number_in_a_full_run() {
        let report = full();
        for goal in &GOALS {
            let measured = goal.measured(&report, 2).unwrap_or_else(|| panic!("{}: nothing of that name is measured", goal.name));
            assert_eq!(measured.doubt, None, "{}", goal.name);
            let one_thread = goal.measured(&report, 1);
            assert_eq!(one_thread.is_some(), !matches!(goal.source, Threads(..)), "{}", goal.name);
        }
    }

    #[test]
    fn verdicts_know_which_side_is_better() {
        let more = goal("", 2.0, 3.0, Dilated(""));
        let less = goal("", 0.6, 0.4, Memory("", false));
        let of = |goal: &Goal, value| goal.verdict(&Measured::sure(value));
        assert_eq!([1.9, 2.0, 3.0].map(|x| of(&more, x)), ["not met", "met", "met, and the aim"]);
        assert_eq!([0.7, 0.6, 0.4].map(|x| of(&less, x)), ["not met", "met", "met, and the aim"]);
    }

    #[test]
    fn a_part_of_the_shapes_and_differing_numbers_are_not_judged() {
        let mut report = full();
        let of_forward = |report: &Report| GOALS[8].verdict(&GOALS[8].measured(report, 2).expect("rows are left"));
        assert_eq!(of_forward(&report), "met, and the aim");
        let differing = report.rows.iter().position(|row| row.topic == "conv" && row.variant == "nchw tuned").expect("a row");
        for row in report.rows.iter_mut().filter(|row| row.topic == "conv") {
            row.difference = 2.0;
        }
        assert_eq!(of_forward(&report), "numbers differ");
        report = full();
        let name = report.rows[differing].case.clone();
        report.rows.retain(|row| row.case != name);
        assert_eq!(of_forward(&report), "13 of 14");
    }
}
