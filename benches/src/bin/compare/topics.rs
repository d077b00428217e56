//! What can be compared: the cases of each topic and the ways in which PyTorch runs them.

use anyhow::Result;
use clap::ValueEnum;
use dimode_autodiff::par;
use dimode_benches::ours::adam::AdamCase;
use dimode_benches::ours::conv::{ConvCase, DIRECT, SHAPES};
use dimode_benches::ours::encoder::EncoderCase;
use dimode_benches::ours::loss_core::LossCase;
use dimode_benches::ours::losses::LOSSES;
use dimode_benches::ours::networks::NetworkCase;
use dimode_benches::ours::pieces::PIECES;
use dimode_benches::ours::step::StepCase;
use dimode_benches::timing::{measure, median};
use dimode_benches::{Case, Inputs, machine};
use serde::Serialize;
use serde_json::json;

use super::duel::Variant;
use super::peer::Allocator::{self, Default, Tuned};
use super::tables::Table;

/// Something that can be asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Topic {
    /// Dense convolutions.
    Conv,
    /// Depth-wise convolutions.
    Depthwise,
    /// The loss core.
    Loss,
    /// Each loss by itself.
    Losses,
    /// Batch norm, point-wise pieces, a convolution with its activation, and Adam.
    Norm,
    /// The ResNet-18 encoder.
    Encoder,
    /// Depth, pose and flow networks.
    Networks,
    /// Whole training steps.
    Step,
    /// Peak memory of training steps.
    Memory,
    /// Heap allocations of our steps in steady state.
    Allocations,
    /// Share of the multiply-adds that the machine can do.
    Peak,
    /// Convolutions of other Rust libraries, whose program is built first; part of `all` with --rust-peers only.
    RustPeers,
    /// Everything.
    All,
}

/// Everything but `all`.
const SINGLE: [Topic; 11] = [
    Topic::Loss,
    Topic::Losses,
    Topic::Conv,
    Topic::Depthwise,
    Topic::Norm,
    Topic::Encoder,
    Topic::Networks,
    Topic::Step,
    Topic::Memory,
    Topic::Allocations,
    Topic::Peak,
];

/// The topics that were asked for, each once.
pub fn chosen(asked: &[Topic], rust_peers: bool) -> Vec<Topic> {
    let all = asked.is_empty() || asked.contains(&Topic::All);
    let mut topics: Vec<_> = SINGLE.into_iter().filter(|topic| all || asked.contains(topic)).collect();
    topics.extend((rust_peers || asked.contains(&Topic::RustPeers)).then_some(Topic::RustPeers));
    topics
}

impl Topic {
    /// Its name on the command line, which its rows carry.
    pub fn key(self) -> String {
        self.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
    }

    /// Title of its tables.
    pub fn title(self) -> &'static str {
        match self {
            Self::Conv => "Convolutions",
            Self::Depthwise => "Depth-wise convolutions",
            Self::Loss => "Loss core, forward and backward",
            Self::Losses => "Each loss by itself, forward and backward",
            Self::Norm => "Batch norm, other pieces, Adam",
            Self::Encoder => "ResNet-18 encoder",
            Self::Networks => "Depth, pose and flow networks",
            Self::Step => "Training step",
            Self::Memory => "Peak memory",
            Self::Allocations => "Allocations",
            Self::Peak => "Share of the peak",
            Self::RustPeers => "Convolutions of other Rust libraries",
            Self::All => "Everything",
        }
    }

    /// Its cases; some of them for a first look.
    pub fn cases(self, quick: bool) -> Vec<Box<dyn Case>> {
        let convs = |wanted: fn(&ConvCase) -> bool, step: usize| -> Vec<Box<dyn Case>> {
            SHAPES.into_iter().filter(wanted).step_by(step).map(|case| Box::new(case) as Box<dyn Case>).collect()
        };
        match self {
            Self::Conv => convs(|case| !case.is_depthwise(), if quick { 4 } else { 1 }),
            Self::Depthwise => convs(ConvCase::is_depthwise, 1),
            Self::Norm => {
                let pieces = PIECES.into_iter().step_by(if quick { 3 } else { 1 }).map(boxed);
                pieces.chain([boxed(AdamCase)]).collect()
            }
            Self::Loss => {
                vec![1, 4].into_iter().take(if quick { 1 } else { 2 }).map(|b| boxed(LossCase::new(b, 192, 640))).collect()
            }
            Self::Losses => LOSSES.into_iter().step_by(if quick { 4 } else { 1 }).map(boxed).collect(),
            Self::Encoder if quick => vec![boxed(EncoderCase::new(16, 4, 64, 192))],
            Self::Encoder => vec![
                boxed(EncoderCase::new(64, 1, 192, 640)),
                boxed(EncoderCase::new(64, 4, 192, 640)),
                boxed(EncoderCase::new(64, 4, 64, 192)),
                boxed(EncoderCase::new(16, 4, 64, 192)),
            ],
            Self::Networks => NetworkCase::all().into_iter().take(if quick { 3 } else { usize::MAX }).map(boxed).collect(),
            Self::Step if quick => vec![boxed(StepCase::nano(4))],
            Self::Step => {
                [StepCase::nano(4), StepCase::monodepth2(1), StepCase::monodepth2(4), StepCase::paper()].map(boxed).into()
            }
            Self::Memory | Self::Allocations | Self::Peak | Self::RustPeers | Self::All => Vec::new(),
        }
    }

    /// The ways in which PyTorch runs its cases.
    pub fn variants(self, compile: bool) -> Vec<Variant> {
        let layout = |allocator: Allocator, layout: &str| Variant { allocator, settings: json!({"layout": layout}) };
        let mode = |allocator: Allocator, mode: &str| Variant { allocator, settings: json!({"mode": mode}) };
        match self {
            Self::Loss => {
                let mut variants = vec![mode(Default, "eager"), mode(Tuned, "eager")];
                variants.extend(compile.then(|| mode(Tuned, "compile")));
                variants
            }
            Self::Losses => vec![mode(Default, "eager"), mode(Tuned, "eager")],
            Self::Norm => vec![layout(Default, "nchw"), layout(Tuned, "nchw")],
            Self::Conv | Self::Depthwise => vec![
                layout(Default, "nchw"),
                layout(Tuned, "nchw"),
                layout(Default, "channels_last"),
                layout(Tuned, "channels_last"),
            ],
            _ => vec![layout(Default, "nchw"), layout(Tuned, "nchw"), layout(Tuned, "channels_last")],
        }
    }
}

fn boxed(case: impl Case + 'static) -> Box<dyn Case> {
    Box::new(case)
}

/// The speed of a convolution beside the machine's.
#[derive(Clone, Debug, Serialize)]
pub struct Share {
    /// Name of the case.
    pub case: String,
    /// Threads.
    pub threads: usize,
    /// Whether it goes by Winograd's scheme.
    pub winograd: bool,
    /// Floating-point operations a second of the convolution forward, as the definition counts them.
    pub defined: f64,
    /// Those that were executed in its products.
    pub executed: f64,
    /// Most that the machine can do.
    pub peak: f64,
}

/// The cases of [`shares`]: the dense 3x3 convolutions without stride, and one that must go the direct way.
pub fn share_cases() -> impl Iterator<Item = ConvCase> {
    SHAPES.into_iter().filter(|case| case.kernel == 3 && case.stride == 1 && !case.is_depthwise()).chain([DIRECT])
}

/// Shares of the peak that convolutions reach forward.
///
/// # Errors
/// When a case cannot be built.
pub fn shares(threads: &[usize], only: &dyn Fn(&str) -> bool) -> Result<Vec<Share>> {
    let mut shares = Vec::new();
    for &threads in threads {
        for case in share_cases().filter(|case| only(case.name)) {
            let mut ours = case.build(&Inputs::Drawn)?;
            // The peak just before and after, since clocks change.
            let (before, time, after) = par::with_threads(threads, || {
                let before = machine::multiply_add_peak();
                let time = median(&measure(ours.as_mut(), "forward", 0.3));
                (before, time, machine::multiply_add_peak())
            });
            shares.push(Share {
                case: case.name.into(),
                threads,
                winograd: case.goes_by_winograd(),
                defined: case.flops() / (1e-3 * time),
                executed: case.executed_flops() / (1e-3 * time),
                peak: before.max(after),
            });
        }
    }
    Ok(shares)
}

/// The shares as a table. Winograd's scheme executes 16 of the definition's 36 multiplications, 25 with stride 2, so "as defined" may pass 100 %.
pub fn shares_table(shares: &[Share]) -> Table {
    let heads = ["convolution forward", "threads", "way", "peak, Gflop/s", "as defined", "share", "executed", "share"];
    let title = "Share of the measured multiply-add peak; Winograd's scheme executes 16/36 of the operations of the definition, 25/36 with stride 2";
    let mut table = Table::new(title, &heads);
    for s in shares {
        let giga = |x: f64| format!("{:.0}", 1e-9 * x);
        let share = |x: f64| format!("{:.0} %", 100.0 * x / s.peak);
        table.push(vec![
            s.case.clone(),
            s.threads.to_string(),
            if s.winograd { "Winograd" } else { "direct" }.into(),
            giga(s.peak),
            giga(s.defined),
            share(s.defined),
            giga(s.executed),
            share(s.executed),
        ]);
    }
    table
}
