//! What is asked for beside what was measured.

use dimode_benches::timing::geometric_mean;

use super::duel::Row;
use super::tables::Table;

/// One goal: its name, and the ratios that are required, aimed at, and near the limit of the machine.
struct Goal {
    name: &'static str,
    asked: [&'static str; 3],
    measured: fn(&[Row]) -> Option<f64>,
}

macro_rules! goal {
    ($name:literal, $asked:expr, $measured:expr) => {
        Goal { name: $name, asked: $asked, measured: $measured }
    };
}

/// The goals for two threads; ratios are the peer's time over ours.
const GOALS: [Goal; 19] = [
    goal!("loss core, 640x192 b1 / eager", ["12", "20", "40"], |r| one(r, "loss core 640x192 b1", "all", "eager default")),
    goal!("loss core, 640x192 b1 / compiled", ["3", "5", "10"], |r| one(r, "loss core 640x192 b1", "all", "compile tuned")),
    goal!("loss core, 640x192 b4 / eager", ["12", "20", "40"], |r| one(r, "loss core 640x192 b4", "all", "eager default")),
    goal!("loss core, 640x192 b4 / compiled", ["3", "5", "10"], |r| one(r, "loss core 640x192 b4", "all", "compile tuned")),
    goal!("geometric losses, b1 / eager", ["8", "12", "25"], |r| one(r, "loss core 640x192 b1", "geom", "eager default")),
    goal!("geometric losses, b1 / compiled", ["3.5", "5", "10"], |r| one(r, "loss core 640x192 b1", "geom", "compile tuned")),
    goal!("14 convolutions forward, mean / nchw tuned", ["0.9", "1.2", "1.5"], |r| dense(r, "forward", "nchw tuned", mean)),
    goal!("14 convolutions forward, mean / channels-last tuned", ["0.7", "0.9", "1.1"], |r| {
        dense(r, "forward", "channels_last tuned", mean)
    }),
    goal!("worst convolution forward / nchw tuned", ["0.5", "0.75", "1.0"], |r| dense(r, "forward", "nchw tuned", worst)),
    goal!("convolution backward data, mean / nchw tuned", ["0.8", "1.15", "1.4"], |r| {
        dense(r, "backward_data", "nchw tuned", mean)
    }),
    goal!("convolution backward weight, mean / nchw tuned", ["0.8", "1.15", "1.4"], |r| {
        dense(r, "backward_weight", "nchw tuned", mean)
    }),
    goal!("depth-wise dilated, all three passes / nchw default", ["4", "9", "15"], |r| dilated(r, "nchw default")),
    goal!("depth-wise dilated, all three passes / nchw tuned", ["4", "9", "15"], |r| dilated(r, "nchw tuned")),
    goal!("ResNet-18 encoder, forward+backward b1 / nchw default", ["0.7", "1.0", "1.5"], |r| {
        one(r, "encoder width 64 640x192 b1", "forward_backward", "nchw default")
    }),
    goal!("training step, 640x192 b1 / nchw default", ["1.3", "2.0", "3.5"], |r| step(
        r,
        "step width 64 640x192 b1",
        "nchw default"
    )),
    goal!("training step, 640x192 b4 / nchw default", ["1.3", "2.0", "3.5"], |r| step(
        r,
        "step width 64 640x192 b4",
        "nchw default"
    )),
    goal!("training step, 192x64 b4 width 16 / nchw default", ["3", "6", "12"], |r| {
        step(r, "step width 16 192x64 b4", "nchw default")
    }),
    goal!("training step, 192x64 b4 width 16 / nchw tuned", ["2", "4.5", "9"], |r| step(
        r,
        "step width 16 192x64 b4",
        "nchw tuned"
    )),
    goal!("training step, 640x192 b1 / channels-last tuned", ["-", "-", "-"], |r| {
        step(r, "step width 64 640x192 b1", "channels_last tuned")
    }),
];

/// The table of goals that were measured.
pub fn table(rows: &[Row], threads: usize) -> Table {
    let title = format!("Goals, {threads} threads (time of the peer / ours)");
    let mut table = Table::new(&title, &["item", "required", "aim", "near the limit", "measured"]);
    let rows: Vec<Row> = rows.iter().filter(|row| row.threads == threads).cloned().collect();
    for goal in GOALS {
        if let Some(measured) = (goal.measured)(&rows) {
            let [required, aim, limit] = goal.asked.map(str::to_owned);
            table.push(vec![goal.name.to_owned(), required, aim, limit, format!("{measured:.2}")]);
        }
    }
    table
}

fn one(rows: &[Row], case: &str, what: &str, variant: &str) -> Option<f64> {
    rows.iter().find(|row| row.case == case && row.what == what && row.variant == variant).map(Row::ratio)
}

fn step(rows: &[Row], case: &str, variant: &str) -> Option<f64> {
    one(rows, case, "step", variant)
}

/// A number of the ratios of all dense convolutions.
fn dense(rows: &[Row], what: &str, variant: &str, number: fn(&[f64]) -> f64) -> Option<f64> {
    let chosen =
        |row: &&Row| row.topic == "conv" && !row.case.starts_with("depthwise") && row.what == what && row.variant == variant;
    let ratios: Vec<f64> = rows.iter().filter(chosen).map(Row::ratio).collect();
    (!ratios.is_empty()).then(|| number(&ratios))
}

/// The sum of the three passes of the dilated depth-wise convolution, theirs over ours.
fn dilated(rows: &[Row], variant: &str) -> Option<f64> {
    let chosen = |row: &&Row| row.topic == "conv" && row.case.starts_with("depthwise 3x3 dilation") && row.variant == variant;
    let (ours, theirs) = rows.iter().filter(chosen).fold((0.0, 0.0), |(o, t), row| (o + row.ours, t + row.theirs));
    (ours > 0.0).then(|| theirs / ours)
}

fn mean(ratios: &[f64]) -> f64 {
    geometric_mean(ratios)
}

fn worst(ratios: &[f64]) -> f64 {
    ratios.iter().copied().fold(f64::INFINITY, f64::min)
}
