//! Runs one kernel once on one thread, after one run that warms up: what `instructions.sh` counts.
//!
//! `once NAME` with a name of [`kernels`]; without a name it prints them.

use std::hint::black_box;
use std::process::ExitCode;

use dimode_autodiff::par;
use dimode_benches::ours::conv::SHAPES;
use dimode_benches::ours::loss_core::LossCase;
use dimode_benches::ours::step::StepCase;
use dimode_benches::{Case, Inputs, Ours};

/// Name, case, what of it.
fn kernels() -> Vec<(&'static str, Box<dyn Case>, &'static str)> {
    let conv = |name: &str| Box::new(SHAPES.into_iter().find(|case| case.name == name).expect("a shape of the list"));
    let loss = || Box::new(LossCase::new(1, 192, 640));
    vec![
        ("loss_core", loss(), "all"),
        ("loss_geometric", loss(), "geom"),
        ("loss_photometric", loss(), "photo"),
        ("conv3x3_64_64", conv("3x3 64-64 48x160"), "forward_backward"),
        ("conv3x3_16_16", conv("3x3 16-16 192x640"), "forward_backward"),
        ("step_nano", Box::new(StepCase::nano(1)), "step"),
    ]
}

fn main() -> ExitCode {
    let asked = std::env::args().nth(1).unwrap_or_default();
    let kernels = kernels();
    let Some((_, case, what)) = kernels.iter().find(|(name, ..)| *name == asked) else {
        kernels.iter().for_each(|(name, ..)| println!("{name}"));
        return if asked.is_empty() { ExitCode::SUCCESS } else { ExitCode::from(2) };
    };
    let mut ours = case.build(&Inputs::Drawn).expect("drawn inputs are always there");
    par::with_threads(1, || {
        ours.repetition(what);
        counted_region(ours.as_mut(), what);
    });
    ExitCode::SUCCESS
}

/// The part whose instructions are counted; the counter knows it by its name.
#[inline(never)]
fn counted_region(ours: &mut (dyn Ours + Send), what: &str) {
    black_box(ours.repetition(what));
}
