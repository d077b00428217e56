//! Files of weights: what is in them, which network they fit, how far two of them are apart.

mod convert;
mod diff;
mod error;
mod inspect;
#[cfg(test)]
mod tests;

pub use convert::{Conversion, ConvertRequest, ConvertedFile, Input, convert};
pub use diff::{Comparison, DiffRequest, TensorDifference, diff};
pub use error::{ConvertError, FileMisfit};
pub use inspect::{Fit, Inspection, TensorSummary, inspect};
