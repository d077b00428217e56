//! What one training step, and the loss core, take from the heap in steady state.
//!
//! Prints one JSON array; `compare allocations` makes a table of it. A program of its own, because the allocator that counts is
//! slower.

use std::alloc::System;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use dimode_autodiff::par;
use dimode_benches::ours::counted;
use dimode_benches::timing::{ends, median};
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
const WARM: usize = 5;
/// Repetitions that are counted.
const COUNTED: usize = 20;

/// `allocations [THREADS [PART_OF_A_NAME]]`
fn main() {
    AllocationRegistry::set_global_tracker(Count).expect("the only tracker");
    AllocationRegistry::enable_tracking();
    let mut arguments = std::env::args().skip(1);
    let threads = arguments.next().and_then(|text| text.parse().ok()).unwrap_or(2);
    let only = arguments.next().unwrap_or_default();
    let cases = counted();
    let wanted = cases.iter().filter(|(case, _)| case.name().contains(&only));
    let found: Vec<Value> = wanted.map(|(case, what)| count(case.as_ref(), what, threads)).collect();
    println!("{}", Value::from(found));
}

/// What one repetition allocates in steady state: the middle of all that were counted, and the most in one of them.
fn count(case: &dyn Case, what: &str, threads: usize) -> Value {
    let mut ours = case.build(&Inputs::Drawn).expect("drawn inputs are always there");
    // Room before, so that the list itself is not counted.
    let mut counted: Vec<[u64; 3]> = Vec::with_capacity(COUNTED);
    par::with_threads(threads, || {
        for _ in 0..WARM {
            ours.repetition(what);
        }
        for _ in 0..COUNTED {
            COUNTERS.iter().for_each(|counter| counter.store(0, Relaxed));
            ours.repetition(what);
            counted.push(COUNTERS.each_ref().map(|counter| counter.load(Relaxed)));
        }
    });
    let [bytes, allocations, large] = [0, 1, 2].map(|k| {
        let numbers: Vec<f64> = counted.iter().map(|numbers| numbers[k] as f64).collect();
        json!({"median": median(&numbers), "most": ends(&numbers).1})
    });
    json!({
        "case": case.name(), "what": what, "threads": threads, "repetitions": COUNTED,
        "bytes": bytes, "allocations": allocations, "large": large
    })
}
