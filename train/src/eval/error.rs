//! What can go wrong in an evaluation. No number is ever returned in place of one of these.

use dimode_geometry::GeometryError;
use thiserror::Error;

/// A failure of an evaluation: bad predictions, bad truth, or a request that the data cannot answer.
#[derive(Debug, Error)]
pub enum EvalError {
    /// Two maps that are compared differ in size.
    #[error(
        "{what}: the prediction is {}x{} (height x width), the ground truth {}x{}; resize the prediction first",
        prediction.0, prediction.1, truth.0, truth.1
    )]
    SizeMismatch {
        /// What is compared, for instance `depth map`.
        what: &'static str,
        /// (height, width) of the prediction in pixels.
        prediction: (usize, usize),
        /// (height, width) of the ground truth in pixels.
        truth: (usize, usize),
    },
    /// Two lists that belong together differ in length.
    #[error("{what}: {prediction} predicted, but {truth} in the ground truth; both must describe the same frames")]
    CountMismatch {
        /// What is counted.
        what: &'static str,
        /// Entries on the predicted side.
        prediction: usize,
        /// Entries on the true side.
        truth: usize,
    },
    /// A depth or disparity value that cannot be evaluated.
    #[error("{what} at row {row}, column {column} is {value}; {requirement}")]
    BadPixel {
        /// Which map, for instance `predicted depth`.
        what: &'static str,
        /// Row of the pixel, from 0.
        row: usize,
        /// Column of the pixel, from 0.
        column: usize,
        /// The value found.
        value: f32,
        /// What the value has to satisfy.
        requirement: &'static str,
    },
    /// No image of the whole evaluation had a pixel to compare.
    #[error("none of the {images} images has a valid ground-truth pixel; check the depth bounds, the crop and the ground truth")]
    NoValidPixels {
        /// How many images were looked at.
        images: usize,
    },
    /// Nothing was handed over to be evaluated.
    #[error("{what}: nothing to evaluate; at least {needed} needed, {found} given")]
    TooFew {
        /// What is missing.
        what: &'static str,
        /// The smallest usable number.
        needed: usize,
        /// How many there were.
        found: usize,
    },
    /// An option of a protocol that makes no sense.
    #[error("{option} = {value}: {requirement}")]
    Option {
        /// Name of the option.
        option: &'static str,
        /// The value given.
        value: f64,
        /// What it has to satisfy.
        requirement: &'static str,
    },
    /// A pose that holds a value which is not finite, or that cannot be inverted.
    #[error("{which}: pose of frame {index} {reason}; repair or leave out the pose")]
    BadPose {
        /// Predicted or true side.
        which: &'static str,
        /// Frame index.
        index: usize,
        /// What is wrong with it.
        reason: &'static str,
    },
    /// Predicted and true trajectory share no frame.
    #[error("the predicted frames ({predicted}) and the true frames ({truth}) have nothing in common; check the frame indices")]
    NoCommonFrame {
        /// First and last predicted index.
        predicted: String,
        /// First and last true index.
        truth: String,
    },
    /// Positions that do not determine the alignment.
    #[error("alignment: {reason}; choose an alignment that needs less, or longer trajectories")]
    Degenerate {
        /// What is missing.
        reason: String,
    },
    /// Another failure of the geometry.
    #[error(transparent)]
    Geometry(GeometryError),
}

impl From<GeometryError> for EvalError {
    fn from(error: GeometryError) -> Self {
        match error {
            GeometryError::DegenerateTrajectory { reason } => Self::Degenerate { reason },
            other => Self::Geometry(other),
        }
    }
}
