//! What the benchmarks share: cases of realistic size and magnitude, and how they are timed.
//!
//! `README.md` says which program measures what.

pub mod camera;
pub mod case;
pub mod criteria;
pub mod inputs;
pub mod machine;
pub mod ours;
pub mod timing;

pub use case::{Case, Ours, Results};
pub use inputs::Inputs;

use dimode::batch::{Batch, Images};
use dimode::config::Config;
use dimode::run::training_frames;
use dimode::teacher::Teacher;
use dimode_autodiff::rng::uniform;
use dimode_autodiff::{Pool, Shape, Tensor};

/// The first batch of a default run of the given batch size.
///
/// # Panics
/// When the embedded world cannot be rendered.
pub fn rendered_batch(config: &Config) -> Batch {
    let frames = training_frames(config).expect("the embedded world needs no files");
    let items: Vec<_> = (0..config.train.batch).map(|i| (i, 1)).collect();
    Batch::load(frames.as_ref(), &items, (&config.train, &Teacher::None), config.seed, 0, &Pool::new()).expect("rendered frames")
}

/// A tensor of colours in [0, 1).
pub fn colours(seed: u64, shape: Shape) -> Tensor<f32> {
    uniform(seed, shape, 0.0, 1.0)
}

/// Three images each of one size, random colours.
pub fn random_images(shape: Shape) -> Images {
    Images { target: colours(1, shape), previous: colours(2, shape), next: colours(3, shape) }
}
