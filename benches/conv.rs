//! Convolution on the shapes of the networks: forward, backward to the input, backward to weight and bias.

use criterion::{Criterion, criterion_group, criterion_main};
use dimode_benches::criteria::bench_case;
use dimode_benches::ours::conv::SHAPES;

fn conv(c: &mut Criterion) {
    for case in SHAPES {
        bench_case(c, &case);
    }
}

criterion_group!(benches, conv);
criterion_main!(benches);
