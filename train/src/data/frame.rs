//! Frames, snippets of three, and the trait of everything that has them.

use std::sync::Arc;

use dimode_geometry::{Intrinsics, Se3};

use super::{DataError, FlowMap, Image, Map};

/// One frame of a sequence.
#[derive(Clone, Debug)]
pub struct Frame {
    /// The picture, colours in [0, 1].
    pub image: Image,
    /// The camera in pixels of this very picture.
    pub intrinsics: Intrinsics,
    /// True depth along the optical axis in metres, 0 unknown; for evaluation.
    pub depth: Option<Map>,
    /// True camera pose, maps camera points to the world; for evaluation.
    pub world_from_camera: Option<Se3>,
    /// What messages and reports call the frame.
    pub name: String,
}

/// What is true between two frames of one sequence.
#[derive(Clone, Debug)]
pub struct PairTruth {
    /// Maps target camera points to source camera points, X_s = R X_t + t.
    pub source_from_target: Se3,
    /// Displacement in pixels from a target pixel to where its point lies in the source.
    pub flow: FlowMap,
    /// One flag per target pixel, row by row: whether the source sees the same point.
    pub visible: Vec<bool>,
}

/// Sequences of frames, addressed by sequence number and frame number, both from 0.
///
/// Implementations return the same frame for the same numbers, whatever was asked before and from whatever thread.
pub trait Dataset: Send + Sync {
    /// What messages and reports call the dataset.
    fn name(&self) -> String;

    /// How many sequences there are.
    fn sequence_count(&self) -> usize;

    /// What messages and reports call a sequence. **Panics** when there is no such sequence.
    fn sequence_name(&self, sequence: usize) -> String;

    /// How many frames a sequence has. **Panics** when there is no such sequence.
    fn sequence_len(&self, sequence: usize) -> usize;

    /// The name of a frame, as [`Frame::name`], without reading it. **Panics** when there is no such frame.
    fn frame_name(&self, sequence: usize, frame: usize) -> String;

    /// One frame.
    ///
    /// **Errors** when the numbers are out of range or the files behind the frame cannot be used.
    fn frame(&self, sequence: usize, frame: usize) -> Result<Arc<Frame>, DataError>;

    /// Truth between two frames of a sequence, `None` where it is not known.
    ///
    /// **Errors** as [`Dataset::frame`].
    fn pair_truth(&self, sequence: usize, target_frame: usize, source_frame: usize) -> Result<Option<PairTruth>, DataError>;

    /// The times of the frames of a sequence in seconds, where they are known. **Panics** when there is no such sequence.
    fn times(&self, sequence: usize) -> Option<&[f64]> {
        let _ = sequence;
        None
    }
}

/// Three consecutive frames, the target in the middle.
#[derive(Clone, Debug)]
pub struct Snippet {
    /// What messages call the snippet: sequence and target frame.
    pub name: String,
    /// The middle frame.
    pub target: Arc<Frame>,
    /// Previous frame, next frame.
    pub sources: [Arc<Frame>; 2],
}

/// The snippet around target `frame` of `sequence`.
///
/// **Errors** when the frame has no two neighbours in its sequence, the sequence does not exist, or a frame cannot be read.
pub fn snippet(dataset: &dyn Dataset, sequence: usize, frame: usize) -> Result<Snippet, DataError> {
    let count = dataset.sequence_count();
    if sequence >= count {
        return Err(DataError::OutOfRange { dataset: dataset.name(), what: "sequence", index: sequence, len: count });
    }
    let len = dataset.sequence_len(sequence);
    let name = format!("{}/{}", dataset.name(), dataset.sequence_name(sequence));
    if frame == 0 || frame + 1 >= len {
        return Err(DataError::OutOfRange { dataset: name, what: "target frame", index: frame, len });
    }
    let target = dataset.frame(sequence, frame)?;
    let sources = [dataset.frame(sequence, frame - 1)?, dataset.frame(sequence, frame + 1)?];
    Ok(Snippet { name: format!("{name}/{}", target.name), target, sources })
}
