//! The synthetic dataset: worlds and frames on demand.

use std::sync::Arc;

use dimode_geometry::Intrinsics;

use super::cache::Cache;
use super::config::SyntheticConfig;
use super::raycast::View;
use super::world::World;
use super::{photometry, render, truth};
use crate::data::{DataError, Dataset, Frame, PairTruth};

/// Bytes of frames that are kept.
const FRAME_BYTES: usize = 64 << 20;
/// Worlds that are kept.
const WORLDS: usize = 48;

/// Rendered sequences. A frame is one sequential piece of work, decided by (configuration, sequence, frame) alone; callers
/// render many frames at the same time. Frames and worlds used lately are kept, in bounded memory.
pub struct SyntheticDataset {
    config: SyntheticConfig,
    intrinsics: Intrinsics,
    worlds: Cache<usize, World>,
    frames: Cache<(usize, usize), Frame>,
}

impl SyntheticDataset {
    /// A dataset of rendered worlds; nothing is rendered yet.
    ///
    /// **Errors** with [`DataError::Option`] when a field of the configuration cannot be used.
    pub fn new(config: SyntheticConfig) -> Result<Self, DataError> {
        config.validate()?;
        let frame_bytes = 16 * config.width * config.height;
        Ok(Self {
            intrinsics: config.intrinsics(),
            worlds: Cache::new(WORLDS),
            frames: Cache::new((FRAME_BYTES / frame_bytes).clamp(3, 4096)),
            config,
        })
    }

    /// What the dataset was made from.
    pub fn config(&self) -> &SyntheticConfig {
        &self.config
    }

    /// The camera of every frame.
    pub fn intrinsics(&self) -> Intrinsics {
        self.intrinsics
    }

    /// Which pixels of a frame see the independently moving object, row by row; none without
    /// [`SyntheticConfig::moving_object`].
    ///
    /// **Errors** when there is no such sequence or frame.
    pub fn moving_mask(&self, sequence: usize, frame: usize) -> Result<Vec<bool>, DataError> {
        self.check(sequence, frame)?;
        Ok(truth::moving_mask(&self.world(sequence), &self.intrinsics, frame))
    }

    /// The world of a sequence.
    pub(super) fn world(&self, sequence: usize) -> Arc<World> {
        self.worlds.get_or_make(sequence, || World::new(&self.config, sequence))
    }

    fn check(&self, sequence: usize, frame: usize) -> Result<(), DataError> {
        let limits = [("sequence", sequence, self.config.sequences), ("frame", frame, self.config.frames)];
        for (what, index, len) in limits {
            if index >= len {
                return Err(DataError::OutOfRange { dataset: self.name(), what, index, len });
            }
        }
        Ok(())
    }

    fn render(&self, sequence: usize, frame: usize) -> Frame {
        let world = self.world(sequence);
        let view = View::new(&world, frame, &self.intrinsics);
        let mut rendered = render::render(&world, &view, frame, self.config.night);
        let seed = self.config.world_seed(sequence);
        photometry::expose(&mut rendered.image, seed, frame, self.config.exposure);
        photometry::add_noise(&mut rendered.image, seed, frame, self.config.noise);
        Frame {
            image: rendered.image,
            intrinsics: self.intrinsics,
            depth: Some(rendered.depth),
            world_from_camera: Some(world.poses[frame]),
            name: name_of(frame),
        }
    }
}

fn name_of(frame: usize) -> String {
    format!("{frame:06}")
}

impl Dataset for SyntheticDataset {
    fn name(&self) -> String {
        format!("synthetic-{}-{}-{}", self.config.preset, self.config.split.name(), self.config.seed)
    }

    fn sequence_count(&self) -> usize {
        self.config.sequences
    }

    #[track_caller]
    fn sequence_name(&self, sequence: usize) -> String {
        assert!(
            sequence < self.config.sequences,
            "SyntheticDataset::sequence_name: sequence {sequence} of {}",
            self.config.sequences
        );
        format!("{sequence:02}")
    }

    #[track_caller]
    fn sequence_len(&self, sequence: usize) -> usize {
        assert!(
            sequence < self.config.sequences,
            "SyntheticDataset::sequence_len: sequence {sequence} of {}",
            self.config.sequences
        );
        self.config.frames
    }

    fn frame_name(&self, _: usize, frame: usize) -> String {
        name_of(frame)
    }

    fn frame(&self, sequence: usize, frame: usize) -> Result<Arc<Frame>, DataError> {
        self.check(sequence, frame)?;
        Ok(self.frames.get_or_make((sequence, frame), || self.render(sequence, frame)))
    }

    fn pair_truth(&self, sequence: usize, target_frame: usize, source_frame: usize) -> Result<Option<PairTruth>, DataError> {
        self.check(sequence, target_frame)?;
        self.check(sequence, source_frame)?;
        let world = self.world(sequence);
        Ok(Some(truth::pair_truth(&world, &self.intrinsics, target_frame, source_frame)))
    }
}
