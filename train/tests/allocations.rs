//! In steady state nothing large comes from the heap: every buffer is one that an earlier step had. On one thread that is so from the
//! third step on, from the fourth with large networks, or from the sixth where steps ask for many kinds of buffers. On two threads it depends on which loops meet: single
//! steps still need a scratch more, less and less.

use std::alloc::System;
use std::backtrace::Backtrace;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

use dimode::batch::{Batch, Images};
use dimode::config::{Config, FirstWeights, LossPreset, StageConfig};
use dimode::model::Model;
use dimode::optim::adamw::State;
use dimode::run::training_frames;
use dimode::teacher::Teacher;
use dimode::trainer::Trainer;
use dimode_autodiff::{Shape, par, rng};
use dimode_geometry::Intrinsics;
use dimode_nets::{DepthNetKind, PoseNetKind};
use tracking_allocator::{AllocationGroupId, AllocationRegistry, AllocationTracker, Allocator};

#[global_allocator]
static ALLOCATOR: Allocator<System> = Allocator::system();

/// Bytes from which on an allocation is large.
const LARGE: usize = 64 << 10;

static LARGE_ONES: AtomicUsize = AtomicUsize::new(0);
/// Where the last large allocation was made.
static LAST: Mutex<Option<Backtrace>> = Mutex::new(None);

struct Count;

impl AllocationTracker for Count {
    fn allocated(&self, _: usize, bytes: usize, _: usize, _: AllocationGroupId) {
        if bytes >= LARGE {
            LARGE_ONES.fetch_add(1, Relaxed);
            if let Ok(mut last) = LAST.lock() {
                *last = Some(Backtrace::force_capture());
            }
        }
    }

    fn deallocated(&self, _: usize, _: usize, _: usize, _: AllocationGroupId, _: AllocationGroupId) {}
}

/// A step of Monodepth2's losses with the networks of a configuration on drawn images.
struct Setting {
    trainer: Trainer,
    batch: Batch,
    stage: StageConfig,
}

impl Setting {
    fn new(nets: (DepthNetKind, PoseNetKind), (n, h, w): (usize, usize, usize)) -> Self {
        let mut config: Config = LossPreset::Monodepth2.config();
        (config.nets.depth, config.nets.pose) = nets;
        let image = |seed| rng::uniform::<f32>(seed, Shape::new(n, 3, h, w), 0.0, 1.0);
        let images = Images { target: image(1), previous: image(2), next: image(3) };
        let (width, height) = (w as f64, h as f64);
        let camera = Intrinsics::new(0.58 * width, 1.92 * height, 0.5 * width, 0.5 * height, w, h).expect("a camera");
        let batch = Batch {
            names: (0..n).map(|i| format!("sample {i}")).collect(),
            snippets: (0..n).map(|i| (i, 1)).collect(),
            flipped: vec![false; n],
            seen: images.clone(),
            plain: images,
            intrinsics: vec![camera; n],
            pseudo_depth: None,
        };
        let weights = Model::new(&config.nets).init(1);
        Setting { trainer: Trainer::new(&config, weights, State::default()), batch, stage: StageConfig::new("all", 1.0) }
    }

    /// Large allocations of each of the first steps.
    fn large(&mut self, steps: u64) -> Vec<usize> {
        let step = |k| {
            LARGE_ONES.store(0, Relaxed);
            self.trainer.step(&self.batch, None, &self.stage, k, 1e-4, false).expect("a finite step");
            LARGE_ONES.load(Relaxed)
        };
        (0..steps).map(step).collect()
    }
}

const NANO: (DepthNetKind, PoseNetKind) = (DepthNetKind::NanoResnet, PoseNetKind::Nano);
const RESNET18: (DepthNetKind, PoseNetKind) = (DepthNetKind::Resnet18, PoseNetKind::Resnet18);

/// Large allocations of each of the first steps of the first and the last stage of a default run, loading included.
fn default_run(steps: u64) -> Vec<(String, Vec<usize>)> {
    let mut config = Config::default();
    (config.data.worlds, config.train.batch) = (1, 2);
    (config.nets.flow_weights, config.nets.pose_weights) = (FirstWeights::Random, FirstWeights::Random);
    let frames = training_frames(&config).expect("rendered frames need no file");
    let stages = [&config.train.stages[0], config.train.stages.last().expect("several stages")];
    let of_stage = |stage: &StageConfig| {
        let mut trainer = Trainer::new(&config, Model::new(&config.nets).init(1), State::default());
        let mut step = |k| {
            LARGE_ONES.store(0, Relaxed);
            let items = [(0, 1), (0, 2)];
            let teacher = Teacher::None;
            let batch = Batch::load(frames.as_ref(), &items, (&config.train, &teacher), config.seed, k, trainer.pool());
            trainer.step(&batch.expect("frames"), None, stage, k, 1e-4, false).expect("a finite step");
            LARGE_ONES.load(Relaxed)
        };
        (stage.name.clone(), (0..steps).map(&mut step).collect())
    };
    stages.map(of_stage).to_vec()
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
fn nothing_large_is_allocated_in_steady_state() {
    AllocationRegistry::set_global_tracker(Count).expect("the only tracker");
    AllocationRegistry::enable_tracking();
    for (name, nets, size, settled) in [("nano", NANO, (4, 64, 192), 2), ("resnet18", RESNET18, (1, 192, 640), 3)] {
        let found = par::with_threads(1, || Setting::new(nets, size).large(settled as u64 + 3));
        println!("{name} on one thread: {found:?}");
        assert!(found[0] > 50, "{name}: nothing was counted");
        assert!(
            found[settled..].iter().all(|&large| large == 0),
            "{name} on one thread: {found:?}; the last one at\n{}",
            last_large()
        );
    }
    // Buffers serve shorter requests, too: with more kinds of requests they take some steps more to find their places.
    for (name, found) in par::with_threads(1, || default_run(10)) {
        println!("{name} of a default run on one thread: {found:?}");
        assert!(found[5..].iter().all(|&large| large == 0), "{name}: {found:?}; the last one at\n{}", last_large());
    }
    // A second worker may need one more scratch of a kind when both happen to need it at once: rarely, and less and less.
    let found = par::with_threads(2, || Setting::new(NANO, (4, 64, 192)).large(24));
    println!("nano on two threads: {found:?}");
    let without = found[2..].iter().filter(|&&large| large == 0).count();
    assert!(without > 11, "nano on two threads: {found:?}");
}
