//! How times grow with image size, batch and threads, beside what the machine allows; a picture as SVG.
//!
//! `scaling [--quick] [--threads 1 2] [--out FILE]`. The dashed lines come from the speeds that are measured first: the
//! floating-point operations over the multiply-add peak, or the bytes that must be moved over the bandwidth of the memory.
//! Operations are counted as the definition of a convolution has them. Winograd's scheme executes 16/36 of them, so a time may lie
//! below its dashed line. The roofline has a second, dashed roof for it, and the list tells both counts.

mod picture;

use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Parser;
use dimode_autodiff::par;
use dimode_benches::ours::conv::{ConvCase, DIRECT, SHAPES};
use dimode_benches::ours::loss_core::LossCase;
use dimode_benches::ours::step::StepCase;
use dimode_benches::timing::{measure, median};
use dimode_benches::{Case, Inputs, machine};

use picture::{Line, Panel, Roofline, Spot};

/// Times of a convolution, the loss core and a training step against size, batch and threads.
#[derive(Parser)]
#[command(name = "scaling")]
struct Arguments {
    /// Threads, one number after the other.
    #[arg(long, num_args = 1.., default_values_t = [1, 2])]
    threads: Vec<usize>,
    /// Fewer and smaller sizes.
    #[arg(long)]
    quick: bool,
    /// Where the picture goes.
    #[arg(long, default_value = "scaling.svg")]
    out: PathBuf,
}

/// Speeds of the machine with some threads.
#[derive(Clone, Copy, Debug)]
pub struct Speeds {
    /// Threads.
    pub threads: usize,
    /// Floating-point operations a second.
    pub flops: f64,
    /// Bytes a second from and to memory.
    pub memory: f64,
    /// Bytes a second from and to the second-level cache.
    pub cache: f64,
}

/// Bytes of one array of the triad: far beyond any cache, and within the second level.
const IN_MEMORY: usize = 256 << 20;
const IN_CACHE: usize = 256 << 10;

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let speeds: Vec<Speeds> = arguments.threads.iter().map(|&threads| speeds(threads)).collect();
    for s in &speeds {
        println!(
            "{} threads: {:.0} Gflop/s, {:.1} GB/s memory, {:.1} GB/s cache",
            s.threads,
            s.flops / 1e9,
            s.memory / 1e9,
            s.cache / 1e9
        );
    }
    let sizes: &[(usize, usize)] = if arguments.quick {
        &[(64, 192), (96, 320), (128, 416)]
    } else {
        &[(64, 192), (96, 320), (128, 416), (192, 640), (256, 832)]
    };
    let batches: &[usize] = if arguments.quick { &[1, 2] } else { &[1, 2, 4, 8] };
    let pixels = |&(h, w): &(usize, usize)| (h * w) as f64 / 1000.0;
    let mut panels = Vec::new();
    for subject in [Subject::Conv, Subject::Loss, Subject::Step] {
        let of_size = |&(h, w): &(usize, usize)| subject.case(1, h, w);
        let of_batch = |&n: &usize| subject.case(n, 96, 320);
        let points: Vec<_> = sizes.iter().map(|size| (pixels(size), of_size(size))).collect();
        panels.push(panel(&format!("{}, batch 1", subject.name()), "thousands of pixels", &points, &speeds)?);
        let points: Vec<_> = batches.iter().map(|n| (*n as f64, of_batch(n))).collect();
        panels.push(panel(&format!("{}, 320 x 96", subject.name()), "batch", &points, &speeds)?);
    }
    let roofline = roofline(&speeds)?;
    let text = picture::draw(&panels, &roofline, &machine::processor());
    fs::write(&arguments.out, text).with_context(|| format!("cannot write {}", arguments.out.display()))?;
    println!("{}", arguments.out.display());
    Ok(())
}

fn speeds(threads: usize) -> Speeds {
    par::with_threads(threads, || Speeds {
        threads,
        flops: machine::multiply_add_peak(),
        memory: machine::triad_bandwidth(IN_MEMORY),
        cache: machine::triad_bandwidth(IN_CACHE),
    })
}

#[derive(Clone, Copy)]
enum Subject {
    Conv,
    Loss,
    Step,
}

/// A case with what to time of it and its seconds at the speeds of the machine, operations counted as defined.
struct Bounded {
    case: Box<dyn Case>,
    what: &'static str,
    bound: Box<dyn Fn(&Speeds) -> f64>,
}

impl Subject {
    fn name(self) -> &'static str {
        match self {
            Self::Conv => "3x3 convolution 32-32 forward",
            Self::Loss => "loss core forward and backward",
            Self::Step => "training step, ResNet-18 of width 64",
        }
    }

    fn case(self, batch: usize, height: usize, width: usize) -> Bounded {
        match self {
            Self::Conv => {
                let case = ConvCase { name: "scaling", batch, inputs: 32, outputs: 32, height, width, ..SHAPES[0].clone() };
                let (flops, bytes) = (case.flops(), case.bytes());
                let bound = Box::new(move |s: &Speeds| (flops / s.flops).max(bytes / s.memory));
                Bounded { case: Box::new(case), what: "forward", bound }
            }
            Self::Loss => {
                let case = LossCase::new(batch, height, width);
                let bytes = case.bytes();
                Bounded { case: Box::new(case), what: "all", bound: Box::new(move |s: &Speeds| bytes / s.memory) }
            }
            Self::Step => {
                let case = StepCase::of(64, [16, 32, 64, 128, 256], batch, height, width);
                let flops = case.flops();
                Bounded { case: Box::new(case), what: "step", bound: Box::new(move |s: &Speeds| flops / s.flops) }
            }
        }
    }
}

/// Milliseconds against `x`, for each number of threads, with the bounds.
fn panel(title: &str, x_label: &str, points: &[(f64, Bounded)], speeds: &[Speeds]) -> Result<Panel> {
    let mut lines = Vec::new();
    for (colour, s) in speeds.iter().enumerate() {
        let mut line = Line {
            name: format!("{} thread{}", s.threads, if s.threads == 1 { "" } else { "s" }),
            colour,
            measured: Vec::new(),
            bound: Vec::new(),
        };
        for (x, bounded) in points {
            let mut ours = bounded.case.build(&Inputs::Drawn)?;
            let time = par::with_threads(s.threads, || median(&measure(ours.as_mut(), bounded.what, 0.2)));
            println!("{title}, {} threads, {x}: {time:.2} ms", s.threads);
            line.measured.push((*x, time));
            line.bound.push((*x, 1e3 * (bounded.bound)(s)));
        }
        lines.push(line);
    }
    Ok(Panel { title: title.to_owned(), x_label: x_label.to_owned(), lines })
}

/// Speed of all convolutions forward against operations per byte, with the most threads.
fn roofline(speeds: &[Speeds]) -> Result<Roofline> {
    let most = *speeds.iter().max_by_key(|s| s.threads).context("at least one number of threads")?;
    let mut spots = Vec::new();
    for case in SHAPES.into_iter().chain([DIRECT]) {
        let mut ours = case.build(&Inputs::Drawn)?;
        let time = par::with_threads(most.threads, || median(&measure(ours.as_mut(), "forward", 0.2)));
        spots.push(Spot {
            name: case.name.to_owned(),
            intensity: case.flops() / case.bytes(),
            speed: case.flops() / (1e-3 * time),
            executed: case.executed_flops() / (1e-3 * time),
        });
    }
    Ok(Roofline { speeds: most, spots })
}
