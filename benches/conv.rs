//! Convolution forward, and forward with both gradients, on shapes of the small networks and of a ResNet-18 at 640 x 192.

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use dimode_autodiff::rng::uniform;
use dimode_autodiff::{Conv2d, Pool, Shape, Tape};

fn shapes() -> Vec<(&'static str, Shape, Shape, Conv2d)> {
    vec![
        ("7x7 s2 3-64 192x640", Shape::new(1, 3, 192, 640), Shape::new(64, 3, 7, 7), Conv2d::new(2, 3)),
        ("3x3 64-64 48x160", Shape::new(1, 64, 48, 160), Shape::new(64, 64, 3, 3), Conv2d::new(1, 1)),
        ("3x3 128-128 24x80", Shape::new(1, 128, 24, 80), Shape::new(128, 128, 3, 3), Conv2d::new(1, 1)),
        ("3x3 512-512 6x20", Shape::new(1, 512, 6, 20), Shape::new(512, 512, 3, 3), Conv2d::new(1, 1)),
        ("3x3 16-16 192x640", Shape::new(1, 16, 192, 640), Shape::new(16, 16, 3, 3), Conv2d::new(1, 1).reflect()),
        ("nano 3x3 16-32 32x64 b8", Shape::new(8, 16, 32, 64), Shape::new(32, 16, 3, 3), Conv2d::new(1, 1)),
        ("nano 3x3 8-8 64x128 b8", Shape::new(8, 8, 64, 128), Shape::new(8, 8, 3, 3), Conv2d::new(1, 1).reflect()),
        ("nano 1x1 147-48 16x32 b8", Shape::new(8, 147, 16, 32), Shape::new(48, 147, 1, 1), Conv2d::new(1, 0)),
    ]
}

fn conv(c: &mut Criterion) {
    for (name, xs, ws, conv) in shapes() {
        let (x, w) = (uniform::<f32>(1, xs, -1.0, 1.0), uniform::<f32>(2, ws, -0.1, 0.1));
        let pool = Pool::new();
        c.bench_with_input(BenchmarkId::new("conv forward", name), &conv, |b, &conv| {
            b.iter(|| {
                let tape = Tape::with_pool(pool.clone());
                tape.constant(x.clone()).conv2d(tape.constant(w.clone()), None, conv).value()
            });
        });
        c.bench_with_input(BenchmarkId::new("conv forward and backward", name), &conv, |b, &conv| {
            b.iter(|| {
                let tape = Tape::with_pool(pool.clone());
                let (x, w) = (tape.leaf(x.clone()), tape.leaf(w.clone()));
                tape.backward(x.conv2d(w, None, conv).sum())
            });
        });
    }
}

criterion_group!(benches, conv);
criterion_main!(benches);
