//! Why weights could not be read, written or given to a network.

use std::fmt;
use std::io;
use std::path::PathBuf;

use ::safetensors::tensor::SafeTensorError;
use thiserror::Error;

use super::{ElementType, PthError};

/// How many differences of each kind a short message names.
const NAMED: usize = 3;

/// A tensor whose dimensions differ from those the network expects.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Misshapen {
    /// Name inside the file.
    pub name: String,
    /// Dimensions the network expects.
    pub expected: Vec<usize>,
    /// Dimensions found in the file.
    pub found: Vec<usize>,
}

impl fmt::Display for Misshapen {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{} {:?} instead of {:?}", self.name, self.found, self.expected)
    }
}

/// All that keeps the tensors of a file from being those of a network. Shown, it counts them and names the first few of each kind.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Differences {
    /// Names the network has and the file has not.
    pub missing: Vec<String>,
    /// Names the file has and the network has not.
    pub extra: Vec<String>,
    /// Tensors of the wrong size.
    pub misshapen: Vec<Misshapen>,
}

impl Differences {
    /// True when names and dimensions are equal.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of differences.
    pub fn len(&self) -> usize {
        self.missing.len() + self.extra.len() + self.misshapen.len()
    }

    /// Every difference, one on a line.
    pub fn list(&self) -> String {
        let lines = self.kinds().into_iter().flat_map(|(kind, all)| all.into_iter().map(move |one| format!("{kind}: {one}\n")));
        lines.collect()
    }

    fn kinds(&self) -> [(&'static str, Vec<String>); 3] {
        let sizes = self.misshapen.iter().map(Misshapen::to_string).collect();
        [("missing", self.missing.clone()), ("not known", self.extra.clone()), ("of another size", sizes)]
    }
}

impl fmt::Display for Differences {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let told = self.kinds().into_iter().filter(|(_, all)| !all.is_empty()).map(|(kind, all)| {
            let (first, rest) = all.split_at(all.len().min(NAMED));
            let more = if rest.is_empty() { "" } else { ", ..." };
            format!("{} {kind} ({}{more})", all.len(), first.join(", "))
        });
        f.write_str(&told.collect::<Vec<_>>().join(", "))
    }
}

/// Why weights could not be read or written.
#[derive(Debug, Error)]
pub enum WeightError {
    /// The file could not be read.
    #[error("cannot read weights from {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The reason given by the system.
        source: io::Error,
    },
    /// The file could not be written.
    #[error("cannot write weights to {}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The reason given by the system.
        source: io::Error,
    },
    /// The content is neither a well-formed safetensors file nor one of PyTorch's.
    #[error("{origin} is not a safetensors file: {source}")]
    Format {
        /// Where the bytes came from.
        origin: String,
        /// What the parser found.
        source: SafeTensorError,
    },
    /// The content is a file of PyTorch that cannot be read or must not be.
    #[error("{origin} {source}")]
    Pth {
        /// Where the bytes came from.
        origin: String,
        /// What is wrong with it.
        source: PthError,
    },
    /// A tensor is stored in a type that is not read.
    #[error("{origin}: '{name}' is stored as {dtype}; convert it to F32 or F64")]
    ElementType {
        /// Where the bytes came from.
        origin: String,
        /// Name inside the file.
        name: String,
        /// The stored type.
        dtype: String,
    },
    /// A weight is stored as whole numbers.
    #[error("{origin}: '{name}' is stored as {element}, which holds no weights; convert it to F32 or F64")]
    NoWeights {
        /// Where the tensors came from.
        origin: String,
        /// Name inside the file.
        name: String,
        /// The stored type.
        element: ElementType,
    },
    /// Two tensors of a file have one name once prefixes of wrappers are taken off.
    #[error("{origin}: '{first}' and '{second}' are the same tensor '{name}'; keep one of them")]
    Twice {
        /// Where the tensors came from.
        origin: String,
        /// The name that both have.
        name: String,
        /// One name as stored.
        first: String,
        /// The other name as stored.
        second: String,
    },
    /// Names or dimensions differ from those of the network. The field holds all differences; the message counts them and names
    /// the first few of each kind.
    #[error("{origin} does not fit the network, tensors: {differences}")]
    Mismatch {
        /// Where the tensors came from.
        origin: String,
        /// All of them.
        differences: Differences,
    },
    /// A weight is infinite or not a number, as a training that broke down leaves it.
    #[error("{origin}: '{name}' holds {value:e} at index {index}; make the weights again, by a training that stays finite")]
    NonFinite {
        /// Where the tensors came from.
        origin: String,
        /// Name inside the file.
        name: String,
        /// Place of the value in the tensor, row-major.
        index: usize,
        /// The value as stored.
        value: f64,
    },
}
