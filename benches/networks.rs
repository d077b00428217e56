//! The networks of the default configuration and of Monodepth2's size: forward, and forward with backward; and what they are made
//! of beside convolutions.

use criterion::{Criterion, criterion_group, criterion_main};
use dimode_benches::criteria::bench_case;
use dimode_benches::ours::encoder::EncoderCase;
use dimode_benches::ours::networks::NetworkCase;
use dimode_benches::ours::pieces::PIECES;

fn pieces(c: &mut Criterion) {
    for case in PIECES {
        bench_case(c, &case);
    }
}

fn networks(c: &mut Criterion) {
    for case in NetworkCase::all() {
        bench_case(c, &case);
    }
    bench_case(c, &EncoderCase::new(64, 1, 192, 640));
    bench_case(c, &EncoderCase::new(16, 4, 64, 192));
}

criterion_group!(benches, pieces, networks);
criterion_main!(benches);
