//! The loss core, forward and backward, at 640 x 192 and at nano size: the four geometric losses as printed, the photometric part,
//! and both; as training computes it, and composed of small operations.

use criterion::{Criterion, criterion_group, criterion_main};
use dimode_benches::criteria::bench_case;
use dimode_benches::ours::loss_core::LossCase;

/// Samples, height, width.
const SIZES: [(usize, usize, usize); 3] = [(1, 192, 640), (4, 192, 640), (8, 64, 128)];

fn loss_core(c: &mut Criterion) {
    for (n, h, w) in SIZES {
        for case in [LossCase::new(n, h, w), LossCase::composed(n, h, w)] {
            bench_case(c, &case);
        }
    }
}

criterion_group!(benches, loss_core);
criterion_main!(benches);
