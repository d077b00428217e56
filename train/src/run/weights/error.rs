//! Why files of weights cannot be converted or compared as asked.

use std::path::PathBuf;

use dimode_nets::NetKind;
use dimode_nets::weights::Differences;
use thiserror::Error;

/// Tensors of a file that are not those of the network.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FileMisfit {
    /// File of the network.
    pub file: String,
    /// Where the tensors came from.
    pub from: PathBuf,
    /// All differences.
    pub differences: Differences,
}

/// Files that cannot be converted as asked.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ConvertError {
    /// A file was named that the network does not have.
    #[error("{network} has no file '{given}'; its files are {}", known.join(", "))]
    UnknownFile {
        /// The network.
        network: NetKind,
        /// The name as given.
        given: String,
        /// Those it has.
        known: Vec<String>,
    },
    /// Neither the name of a file nor its tensors say what it is.
    #[error(
        "{}: neither its name nor its tensors tell which file of {network} it is; write FILE=PATH, FILE being {}",
        path.display(), known.join(" or ")
    )]
    Unclear {
        /// Where it is.
        path: PathBuf,
        /// The network.
        network: NetKind,
        /// The files it may be.
        known: Vec<String>,
    },
    /// Two files have tensors for the same file of the network.
    #[error("{} and {} both are '{file}'; give one of them", first.display(), second.display())]
    Twice {
        /// File of the network.
        file: String,
        /// One of them.
        first: PathBuf,
        /// The other.
        second: PathBuf,
    },
    /// Not all files of the network are given.
    #[error("{network} also needs {}; give all its files, or --partial for those that are there", missing.join(", "))]
    NotAll {
        /// The network.
        network: NetKind,
        /// The files without a source.
        missing: Vec<String>,
    },
    /// Tensors are not those of the network.
    #[error(
        "{}; find the network with 'dimode weights inspect', or take what fits with --partial",
        misfits.iter().map(|m| format!("{} does not fit {network}, tensors: {}", m.from.display(), m.differences)).collect::<Vec<_>>().join(" and ")
    )]
    Misfit {
        /// The network.
        network: NetKind,
        /// All of them.
        misfits: Vec<FileMisfit>,
    },
    /// What was written does not read as what was meant.
    #[error("{}: reads differently from what was written; check the disk", path.display())]
    ReadBack {
        /// The file.
        path: PathBuf,
    },
    /// A folder and a file are to be compared.
    #[error("{} and {}: one is a folder and the other is not; name two files or two folders", a.display(), b.display())]
    FileAndFolder {
        /// One of them.
        a: PathBuf,
        /// The other.
        b: PathBuf,
    },
}

impl ConvertError {
    /// Whether the command was wrong, and not the files.
    pub fn is_usage(&self) -> bool {
        !matches!(self, Self::Misfit { .. } | Self::ReadBack { .. })
    }
}
