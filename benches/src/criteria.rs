//! Cases as benchmarks of criterion.

use std::time::Duration;

use criterion::{Criterion, SamplingMode};

use crate::{Case, Inputs};

/// Times everything of a case on drawn inputs.
///
/// # Panics
/// When the case cannot be built.
pub fn bench_case(c: &mut Criterion, case: &dyn Case) {
    let mut group = c.benchmark_group(case.name());
    // Some cases take seconds.
    group.sample_size(10).sampling_mode(SamplingMode::Flat).measurement_time(Duration::from_secs(2));
    for &what in case.whats() {
        let mut ours = case.build(&Inputs::Drawn).expect("drawn inputs are always there");
        // Ours tells the time itself, since preparations do not count.
        group.bench_function(what, |b| b.iter_custom(|times| (0..times).map(|_| ours.repetition(what)).sum()));
    }
    group.finish();
}
