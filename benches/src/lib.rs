//! What the benchmarks share: cases of realistic size and magnitude, and how they are timed.
//!
//! `README.md` says which program measures what.

pub mod camera;
pub mod case;
pub mod criteria;
pub mod inputs;
pub mod machine;
pub mod ours;
pub mod scene;
pub mod timing;

pub use case::{Case, Ours, Results};
pub use inputs::Inputs;

use dimode::batch::Batch;
use dimode::config::Config;
use dimode::run::training_frames;
use dimode::teacher::Teacher;
use dimode_autodiff::Pool;

/// The first batch of a default run of the given batch size.
///
/// # Panics
/// When the embedded world cannot be rendered.
pub fn rendered_batch(config: &Config) -> Batch {
    let frames = training_frames(config).expect("the embedded world needs no files");
    let items: Vec<_> = (0..config.train.batch).map(|i| (i, 1)).collect();
    Batch::load(frames.as_ref(), &items, (&config.train, &Teacher::None), config.seed, 0, &Pool::new()).expect("rendered frames")
}
