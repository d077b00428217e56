//! Why a checkpoint could not be written or read.

use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

/// A failure to write or read a checkpoint.
#[derive(Debug, Error)]
pub enum CheckpointError {
    /// The system refused to read.
    #[error("{}: the checkpoint cannot be read ({source}); {advice}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        #[source]
        source: io::Error,
        /// What to do about it.
        advice: &'static str,
    },
    /// The system refused to write. The previous checkpoint is still in place.
    #[error("{}: the checkpoint cannot be written ({source}); {advice}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        #[source]
        source: io::Error,
        /// What to do about it.
        advice: &'static str,
    },
    /// The content is not a whole checkpoint.
    #[error("{}: not a usable checkpoint ({reason}); take another one or train again", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// What was found.
        reason: String,
    },
}

impl CheckpointError {
    pub(super) fn read(path: &Path, source: io::Error) -> Self {
        let advice = match source.kind() {
            io::ErrorKind::NotFound => "name the folder of a run that wrote one",
            _ => "check that it is a readable file",
        };
        Self::Read { path: path.to_owned(), source, advice }
    }

    pub(super) fn write(path: &Path, source: io::Error) -> Self {
        let advice = match source.kind() {
            io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
                "free some space; a run goes on from its last checkpoint with --resume"
            }
            io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => "choose a folder that may be written to",
            io::ErrorKind::NotFound => "create the folder first",
            _ => "choose another place or check the disk",
        };
        Self::Write { path: path.to_owned(), source, advice }
    }

    pub(super) fn format(path: &Path, reason: String) -> Self {
        Self::Format { path: path.to_owned(), reason }
    }
}
