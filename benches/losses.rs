//! Each loss by itself, forward and backward, at 640 x 192; the geometric ones also composed of small operations.

use criterion::{Criterion, criterion_group, criterion_main};
use dimode_benches::criteria::bench_case;
use dimode_benches::ours::losses::{COMPOSED, LOSSES};

fn losses(c: &mut Criterion) {
    for case in LOSSES.iter().chain(&COMPOSED) {
        bench_case(c, case);
    }
}

criterion_group!(benches, losses);
criterion_main!(benches);
