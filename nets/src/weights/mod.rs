//! Parameters in files: read from safetensors and from PyTorch's zip files, checked strictly, written atomically as safetensors.
//!
//! [`open`] tells the two forms apart by content and reads every tensor of the state dict. Nothing in a file is executed: a
//! PyTorch file is a pickle, a program for a small machine, and the one here knows tensors, dictionaries and plain values only.
//! [`assign`] then gives the values to a network whose names and dimensions they must have, all or nothing; [`assign_partial`]
//! takes what fits and says what it left. [`dialects`] tells names that other programs use for the same networks.

mod assign;
mod difference;
mod error;
mod files;
mod names;
mod pth;
mod safetensors;
mod stored;

pub mod dialects;

pub use assign::{assign, assign_partial, differences};
pub use difference::{Difference, difference};
pub use error::{Differences, Misshapen, WeightError};
pub use files::{ENDINGS, load, load_directory, open, parse, parse_file, read, save, save_directory, to_bytes};
pub use names::{by_plain_name, plain_name, resolve_aliases};
pub use pth::PthError;
pub use stored::{ElementType, Form, Ignored, StoredTensor, WeightFile};

#[cfg(test)]
mod tests;
