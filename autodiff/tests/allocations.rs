//! A training step in steady state takes its buffers from the pool.

use std::alloc::System;
use std::backtrace::Backtrace;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::sync::{Arc, Mutex};

use dimode_autodiff::gradcheck::random;
use dimode_autodiff::ops::bilinear_sample::SamplePadding;
use dimode_autodiff::{Conv2d, PadMode, Pool, Shape, Tape, Tensor, Var, par};
use tracking_allocator::{AllocationGroupId, AllocationRegistry, AllocationTracker, Allocator};

#[global_allocator]
static ALLOCATOR: Allocator<System> = Allocator::system();

/// Bytes from which on an allocation is large: what the system clears page by page is slow to touch first.
const LARGE: usize = 64 << 10;

static ALLOCATIONS: AtomicUsize = AtomicUsize::new(0);
static BYTES: AtomicUsize = AtomicUsize::new(0);
static LARGE_ONES: AtomicUsize = AtomicUsize::new(0);
/// Where the last large allocation was made.
static LAST: Mutex<Option<Backtrace>> = Mutex::new(None);

struct Count;

impl AllocationTracker for Count {
    fn allocated(&self, _: usize, bytes: usize, _: usize, _: AllocationGroupId) {
        ALLOCATIONS.fetch_add(1, Relaxed);
        BYTES.fetch_add(bytes, Relaxed);
        if bytes >= LARGE {
            LARGE_ONES.fetch_add(1, Relaxed);
            if let Ok(mut last) = LAST.lock() {
                *last = Some(Backtrace::force_capture());
            }
        }
    }

    fn deallocated(&self, _: usize, _: usize, _: usize, _: AllocationGroupId, _: AllocationGroupId) {}
}

/// What one step took from the heap.
#[derive(Clone, Copy, Debug)]
struct Taken {
    allocations: usize,
    bytes: usize,
    large: usize,
}

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

/// What each of `steps` steps takes on `threads` threads, with one pool for all of them.
fn taken(threads: usize, steps: usize) -> Vec<Taken> {
    par::with_threads(threads, || {
        let mut setting = Setting::new();
        let measured = |_| {
            for counter in [&ALLOCATIONS, &BYTES, &LARGE_ONES] {
                counter.store(0, Relaxed);
            }
            setting.step();
            let [allocations, bytes, large] = [&ALLOCATIONS, &BYTES, &LARGE_ONES].map(|counter| counter.load(Relaxed));
            Taken { allocations, bytes, large }
        };
        (0..steps).map(measured).collect()
    })
}

/// About 800 and 450 kB: nodes of the tape, and sums of weight gradients in `f64` before they are rounded.
fn is_little(step: Taken, first: Taken) -> bool {
    step.large == 0 && step.allocations < 1000 && step.bytes < 600_000 && step.bytes < first.bytes / 10
}

/// Where the last large allocation was made; nothing is counted while it is put into words.
fn last_large() -> String {
    AllocationRegistry::untracked(|| {
        let place = LAST.lock().map(|mut last| last.take()).ok().flatten();
        place.map_or_else(String::new, |place| place.to_string())
    })
}

/// One test in this file: the allocator counts for the whole process.
#[test]
fn a_step_in_steady_state_allocates_little_and_nothing_large() {
    AllocationRegistry::set_global_tracker(Count).expect("the only tracker");
    AllocationRegistry::enable_tracking();
    let alone = taken(1, 6);
    println!("each step on one thread: {alone:?}");
    for (k, &step) in alone.iter().enumerate().skip(2) {
        assert!(
            is_little(step, alone[0]),
            "step {k} on one thread: {step:?}, the first {:?}; the last large at\n{}",
            alone[0],
            last_large()
        );
    }

    // Whether two pieces of work need their scratch at one time is up to the threads, so the pool may grow in any step.
    // It never holds more than one scratch a thread: most steps allocate little, and all growth together is bounded.
    let together = taken(2, 16);
    println!("each step on two threads: {together:?}");
    let first = together[0];
    let later = &together[2..];
    let little = later.iter().filter(|&&step| is_little(step, first)).count();
    assert!(little > later.len() / 2, "{little} of {} steps on two threads: {later:?}", later.len());
    let large: usize = later.iter().map(|step| step.large).sum();
    assert!(large < first.large / 4, "{large} large ones after the second step on two threads, {} in the first", first.large);
}
