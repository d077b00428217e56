//! Where the frames come from: rendered worlds of several kinds, a new one for every two samples.

use anyhow::Result;
use dimode_autodiff::par;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::settings::Settings;
use super::task::Task;
use crate::data::synthetic::{Preset, Split, SyntheticConfig, SyntheticDataset};
use crate::data::{DataError, Dataset};

/// Frames of each world.
const FRAMES: usize = 4;

/// Rendered worlds, more than a training uses.
pub struct Worlds {
    kinds: Vec<SyntheticDataset>,
    split: Split,
    seed: u64,
}

impl Worlds {
    /// Worlds of the given kinds for a task.
    ///
    /// # Errors
    /// When worlds cannot be rendered in this size.
    pub fn open<T: Task>(settings: &Settings, presets: &[Preset], split: Split) -> Result<Self, DataError> {
        let one = |&preset| {
            SyntheticDataset::new(SyntheticConfig {
                preset,
                width: settings.width,
                height: settings.height,
                seed: settings.seed,
                split,
                sequences: settings.steps.max(1) * settings.batch.max(T::FINAL_PAIRS),
                frames: FRAMES,
                ..SyntheticConfig::default()
            })
        };
        Ok(Worlds { kinds: presets.iter().map(one).collect::<Result<_, _>>()?, split, seed: settings.seed ^ T::STREAM })
    }

    /// Whether they are for training or held out.
    pub fn split(&self) -> Split {
        self.split
    }

    /// The samples of a step, counted from 0. `make` is given the kind of worlds, the number of the world, that of the sample
    /// (counted through all steps), and the sample's own random numbers.
    ///
    /// # Errors
    /// Those of `make`.
    pub fn samples<S: Send>(
        &self,
        step: usize,
        count: usize,
        make: impl Fn(&SyntheticDataset, usize, usize, ChaCha8Rng) -> Result<S> + Sync,
    ) -> Result<Vec<S>> {
        let samples = par::map_indices(count, |i| {
            let index = step * count + i;
            let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
            rng.set_stream(index as u64);
            let dataset = &self.kinds[index / 2 % self.kinds.len()];
            make(dataset, index / 2 % dataset.sequence_count(), index, rng)
        });
        samples.into_iter().collect()
    }
}
