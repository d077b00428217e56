//! What one training step, and the loss core, take from the heap in steady state.
//!
//! Prints one JSON array; `compare allocations` makes a table of it. A program of its own, because the allocator that counts is
//! slower.

use std::alloc::System;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use dimode_autodiff::par;
use dimode_benches::ours::loss_core::LossCase;
use dimode_benches::ours::step::StepCase;
use dimode_benches::{Case, Inputs};
use serde_json::{Value, json};
use tracking_allocator::{AllocationGroupId, AllocationRegistry, AllocationTracker, Allocator};

#[global_allocator]
static ALLOCATOR: Allocator<System> = Allocator::system();

/// Bytes from which on an allocation is large.
const LARGE: usize = 64 << 10;

/// Bytes, allocations, large allocations.
static COUNTERS: [AtomicU64; 3] = [const { AtomicU64::new(0) }; 3];

struct Count;

impl AllocationTracker for Count {
    fn allocated(&self, _: usize, bytes: usize, _: usize, _: AllocationGroupId) {
        for (counter, more) in COUNTERS.iter().zip([bytes as u64, 1, u64::from(bytes >= LARGE)]) {
            counter.fetch_add(more, Relaxed);
        }
    }

    fn deallocated(&self, _: usize, _: usize, _: usize, _: AllocationGroupId, _: AllocationGroupId) {}
}

/// Repetitions before those that are counted.
const WARM: usize = 3;
/// Repetitions that are counted; the one that takes least is told.
const COUNTED: usize = 3;

fn main() {
    AllocationRegistry::set_global_tracker(Count).expect("the only tracker");
    AllocationRegistry::enable_tracking();
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
            COUNTERS.iter().for_each(|counter| counter.store(0, Relaxed));
            ours.repetition(what);
            COUNTERS.each_ref().map(|counter| counter.load(Relaxed))
        });
        counted.min().expect("at least one repetition")
    });
    let [bytes, allocations, large] = taken;
    json!({"case": case.name(), "what": what, "bytes": bytes, "allocations": allocations, "large": large})
}
