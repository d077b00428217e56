//! What one training step, and the loss core, take from the heap in steady state.
//!
//! Prints one JSON array; `compare allocations` makes a table of it. A program of its own, because the allocator that counts is
//! slower. It knows numbers and bytes, not the size of each allocation: bytes / 64 KiB is an upper bound of how many can have
//! been of 64 KiB or more, and 0 proves that there was none.

use std::alloc::System;

use dimode_autodiff::par;
use dimode_benches::ours::loss_core::LossCase;
use dimode_benches::ours::step::StepCase;
use dimode_benches::{Case, Inputs};
use serde_json::{Value, json};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// Repetitions before those that are counted.
const WARM: usize = 3;
/// Repetitions that are counted; the one that takes least is told.
const COUNTED: usize = 3;

fn main() {
    let threads = std::env::args().nth(1).and_then(|text| text.parse().ok()).unwrap_or(2);
    let cases: [(Box<dyn Case>, &str); 4] = [
        (Box::new(StepCase::monodepth2(1)), "step"),
        (Box::new(StepCase::nano(4)), "step"),
        (Box::new(LossCase::new(1, 192, 640)), "geom"),
        (Box::new(LossCase::new(1, 192, 640)), "photo"),
    ];
    let found: Vec<Value> = cases.iter().map(|(case, what)| count(case.as_ref(), what, threads)).collect();
    println!("{}", Value::from(found));
}

/// What one repetition allocates in steady state.
fn count(case: &dyn Case, what: &str, threads: usize) -> Value {
    let mut ours = case.build(&Inputs::Drawn).expect("drawn inputs are always there");
    let taken = par::with_threads(threads, || {
        for _ in 0..WARM {
            ours.repetition(what);
        }
        let counted = (0..COUNTED).map(|_| {
            let region = Region::new(ALLOCATOR);
            ours.repetition(what);
            let change = region.change();
            (change.bytes_allocated, change.allocations + change.reallocations)
        });
        counted.min().expect("at least one repetition")
    });
    json!({"case": case.name(), "what": what, "bytes": taken.0, "allocations": taken.1})
}
