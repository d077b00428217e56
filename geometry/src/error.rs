//! The one error type of this crate.

use std::path::PathBuf;

use thiserror::Error;

/// What data, files or a degenerate configuration can cause in this crate.
#[derive(Debug, Error)]
pub enum GeometryError {
    /// A camera model that no pinhole camera can have.
    #[error(
        "intrinsics: {field} = {value} is not usable ({requirement}); check the calibration file and the image size it belongs to"
    )]
    Intrinsics {
        /// Name of the offending field.
        field: &'static str,
        /// The value found.
        value: f64,
        /// What the value has to satisfy.
        requirement: &'static str,
    },
    /// A 3x3 matrix that should be a rotation and is not.
    #[error(
        "{what}: the 3x3 part is not a rotation, largest entry of |R^T R - I| is {deviation:.3e} (allowed {tolerance:.1e}), determinant {determinant:.6}; check the file format and the row order"
    )]
    NotARotation {
        /// Where the matrix comes from.
        what: String,
        /// Largest absolute entry of `R^T R - I`.
        deviation: f64,
        /// The limit that was exceeded.
        tolerance: f64,
        /// Determinant of the matrix.
        determinant: f64,
    },
    /// A trajectory or point set that does not determine the requested quantity.
    #[error("degenerate trajectory: {reason}")]
    DegenerateTrajectory {
        /// What is missing.
        reason: String,
    },
    /// Two lists that must have the same length.
    #[error("{what}: {left} and {right} entries, the counts must agree")]
    CountMismatch {
        /// What is compared.
        what: &'static str,
        /// Entries of the first list.
        left: usize,
        /// Entries of the second list.
        right: usize,
    },
    /// A line of a text file that cannot be read.
    #[error("{}:{line}: {reason}", path.display())]
    Parse {
        /// The file.
        path: PathBuf,
        /// Line number, counted from 1.
        line: usize,
        /// What is wrong and what was expected.
        reason: String,
    },
    /// A file that cannot be opened, read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The operating system's answer.
        source: std::io::Error,
    },
}
