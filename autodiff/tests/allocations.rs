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

/// One test in this file: the allocator counts for the whole process.
#[test]
fn a_step_in_steady_state_allocates_little() {
    par::with_threads(2, || {
        let mut setting = Setting::new();
        let mut measured = |_| {
            let region = Region::new(ALLOCATOR);
            setting.step();
            let change = region.change();
            (change.allocations + change.reallocations, change.bytes_allocated)
        };
        let steps: Vec<_> = (0..6).map(&mut measured).collect();
        println!("(allocations, bytes) of each step: {steps:?}");
        let first = steps[0];
        // About 800 and 450 kB: nodes of the tape, and sums of weight gradients in `f64` before they are rounded.
        for (k, &(count, bytes)) in steps.iter().enumerate().skip(2) {
            assert!(count < 1000, "step {k}: {count} allocations");
            assert!(bytes < 600_000 && bytes < first.1 / 10, "step {k}: {bytes} bytes of {} in the first", first.1);
        }
    });
}
