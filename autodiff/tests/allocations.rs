//! A training step in steady state takes its buffers from the pool.

use std::alloc::System;
use std::sync::Arc;

use dimode_autodiff::gradcheck::random;
use dimode_autodiff::ops::bilinear_sample::SamplePadding;
use dimode_autodiff::{Conv2d, PadMode, Pool, Shape, Tape, Tensor, Var, par};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

const IMAGES: Shape = Shape::new(2, 3, 64, 96);

fn conv<'t>(x: Var<'t, f32>, weight: Var<'t, f32>, stride: usize, padding: usize, pad_mode: PadMode) -> Var<'t, f32> {
    x.conv2d(weight, None, Conv2d { pad_mode, ..Conv2d::new(stride, padding) })
}

/// Weights of a small network, and what it is trained on.
struct Setting {
    weights: Vec<Tensor<f32>>,
    images: Tensor<f32>,
    coords: Tensor<f32>,
    pool: Arc<Pool<f32>>,
}

impl Setting {
    fn new() -> Self {
        let shapes = [
            Shape::new(16, 3, 7, 7),
            Shape::new(1, 16, 1, 1),
            Shape::new(32, 16, 3, 3),
            Shape::new(1, 32, 1, 1),
            Shape::new(32, 32, 1, 1),
            Shape::new(8, 48, 3, 3),
            Shape::new(1, 8, 3, 3),
        ];
        let weights = shapes.iter().enumerate().map(|(k, &shape)| random(k as u64, shape, -0.2, 0.3)).collect();
        let coords = random(20, Shape::new(2, 2, 64, 96), 0.0, 60.0);
        Setting { weights, images: random(10, IMAGES, 0.0, 1.0), coords, pool: Pool::new() }
    }

    /// Depth network in small: strided, plain and pointwise convolutions, norm, pooling, skip, upsampling, warp, photometric error.
    fn step(&mut self) {
        let tape = Tape::with_pool(self.pool.clone());
        let w: Vec<_> = self.weights.iter().map(|w| tape.leaf(w.clone())).collect();
        let image = tape.constant(self.images.clone());
        let skip = conv(image, w[0], 2, 3, PadMode::Zero).batch_norm_train(w[1], w[1], 1e-5).y.relu();
        let deep = conv(skip.max_pool2d(3, 2, 1), w[2], 1, 1, PadMode::Zero).batch_norm_train(w[3], w[3], 1e-5).y.elu();
        let deep = conv(deep, w[4], 1, 0, PadMode::Zero).sigmoid().upsample_nearest(2);
        let joined = conv(Var::concat(&[deep, skip], 1), w[5], 1, 1, PadMode::Reflect).elu();
        let disparity = conv(joined.upsample_nearest(2), w[6], 1, 1, PadMode::Reflect).sigmoid();
        let coords = tape.constant(self.coords.clone()).add(disparity.broadcast_to(self.coords.shape()));
        let error = image.bilinear_sample(coords, SamplePadding::Border).sub(image).abs().mean_channels();
        let smooth = disparity.slice(3, 1, 95).sub(disparity.slice(3, 0, 95)).abs().mean();
        let grads = tape.backward_and_free(error.mean().add(smooth));
        for (weight, var) in self.weights.iter_mut().zip(&w) {
            let gradient = grads.wrt(*var);
            let moved = weight.data().iter().zip(gradient.data()).map(|(w, g)| w - 1e-3 * g).collect();
            *weight = Tensor::from_vec(weight.shape(), moved);
        }
    }
}

/// (allocations, bytes) of each of `steps` steps on `threads` threads, with one pool for all of them.
fn allocations(threads: usize, steps: usize) -> Vec<(usize, usize)> {
    par::with_threads(threads, || {
        let mut setting = Setting::new();
        let measured = |_| {
            let region = Region::new(ALLOCATOR);
            setting.step();
            let change = region.change();
            (change.allocations + change.reallocations, change.bytes_allocated)
        };
        (0..steps).map(measured).collect()
    })
}

/// About 800 and 450 kB: nodes of the tape, and sums of weight gradients in `f64` before they are rounded.
fn is_little((count, bytes): (usize, usize), first: (usize, usize)) -> bool {
    count < 1000 && bytes < 600_000 && bytes < first.1 / 10
}

/// One test in this file: the allocator counts for the whole process.
#[test]
fn a_step_in_steady_state_allocates_little() {
    let alone = allocations(1, 6);
    println!("(allocations, bytes) of each step on one thread: {alone:?}");
    for (k, &step) in alone.iter().enumerate().skip(2) {
        assert!(is_little(step, alone[0]), "step {k} on one thread: {step:?}, the first {:?}", alone[0]);
    }

    // Whether two pieces of work need their scratch at one time is up to the threads, so the pool may grow in any step.
    // It never holds more than one scratch a thread: most steps allocate little, and all growth together is bounded.
    let together = allocations(2, 16);
    println!("(allocations, bytes) of each step on two threads: {together:?}");
    let first = together[0];
    let later = &together[2..];
    let little = later.iter().filter(|&&step| is_little(step, first)).count();
    assert!(little > later.len() / 2, "{little} of {} steps on two threads: {later:?}", later.len());
    let least = later.iter().map(|step| step.1).min().expect("several steps");
    let growth: usize = later.iter().map(|step| step.1 - least).sum();
    assert!(growth < first.1, "the pool grew by {growth} bytes on two threads, the first step took {first:?}");
}
