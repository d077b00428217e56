//! What can go wrong with data: one error type that says where, what, and what to do.

use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

/// A failure to read, check or write data. Every variant names the place and the reason; the message ends with what to do.
#[derive(Debug, Error)]
pub enum DataError {
    /// A file or folder that is needed does not exist.
    #[error("{}: {what} not found; {advice}", path.display())]
    Missing {
        /// Where it was looked for.
        path: PathBuf,
        /// What should be there, for instance `calib.txt`.
        what: String,
        /// What to do about it.
        advice: String,
    },
    /// The operating system refused to read.
    #[error("{}: cannot be read ({source}); check that it is a readable file or folder", path.display())]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// The system's reason.
        #[source]
        source: io::Error,
    },
    /// The operating system refused to write; nothing half-written is left under the final name.
    #[error("{}: cannot be written ({source}); {advice}", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The system's reason.
        #[source]
        source: io::Error,
        /// What to do about it.
        advice: String,
    },
    /// A file that can be read but whose content is not what it should be.
    #[error("{}{}: {reason}; {advice}", path.display(), line_suffix(*line))]
    Malformed {
        /// The file.
        path: PathBuf,
        /// The line, from 1, for text files.
        line: Option<usize>,
        /// What was found and what was expected.
        reason: String,
        /// What to do about it.
        advice: String,
    },
    /// Two images of one sequence differ in size.
    #[error(
        "{}: size {}x{}, but {} is {}x{}; all frames of a sequence must have one size, resize them or split the sequence",
        path.display(), size.0, size.1, other_path.display(), other_size.0, other_size.1
    )]
    SizeMismatch {
        /// The image that differs.
        path: PathBuf,
        /// Its (width, height) in pixels.
        size: (usize, usize),
        /// The image it is compared with.
        other_path: PathBuf,
        /// The (width, height) of the other image in pixels.
        other_size: (usize, usize),
    },
    /// A sequence with too few frames for one snippet.
    #[error("{}: {found} frame(s) found, but {}; add frames or name another folder", path.display(), need(*needed))]
    TooFewFrames {
        /// The folder of the frames.
        path: PathBuf,
        /// How many there are.
        found: usize,
        /// How many are needed.
        needed: usize,
    },
    /// Files that belong together have different numbers of entries.
    #[error("{}: {found} {what}, but {expected} frames in {}; {advice}", path.display(), frames.display())]
    CountMismatch {
        /// The file with the wrong count.
        path: PathBuf,
        /// What is counted, for instance `poses`.
        what: &'static str,
        /// How many entries the file has.
        found: usize,
        /// How many frames there are.
        expected: usize,
        /// The folder of the frames.
        frames: PathBuf,
        /// What to do about it.
        advice: String,
    },
    /// A folder that this program wrote and may replace is there, and replacing was not asked for.
    #[error("{}: already written; name another folder, or add --force to replace this one", path.display())]
    Occupied {
        /// The folder.
        path: PathBuf,
    },
    /// The folder to replace holds something else than what the command writes.
    #[error("{}: not empty, and not made by this command; name another folder, --force will not replace this one", path.display())]
    NotOurs {
        /// The folder.
        path: PathBuf,
    },
    /// The place for new files is taken, and the command replaces nothing.
    #[error("{}: already there; name a folder that is new or empty", path.display())]
    NotEmpty {
        /// The file or folder.
        path: PathBuf,
    },
    /// Something else has the name under which output is prepared.
    #[error("{}: in the way, output is prepared under this name; move it away, or write to another folder", path.display())]
    StagingTaken {
        /// The file or folder.
        path: PathBuf,
    },
    /// An option that cannot be used as given.
    #[error("{option} = {value}: {reason}")]
    Option {
        /// The name of the option.
        option: &'static str,
        /// The value that was given.
        value: String,
        /// Why it cannot be used and what could.
        reason: String,
    },
    /// A sequence or frame number outside a dataset.
    #[error("{dataset}: {what} {index} asked for, but there are {len} (0 to {})", len.saturating_sub(1))]
    OutOfRange {
        /// The dataset or sequence.
        dataset: String,
        /// What is numbered: `sequence`, `frame` or `target frame`.
        what: &'static str,
        /// The number that was asked for.
        index: usize,
        /// How many there are.
        len: usize,
    },
}

fn need(frames: usize) -> String {
    match frames {
        3 => "training needs at least three frames (previous, target, next)".to_owned(),
        _ => format!("at least {frames} must be there, as PNG or JPEG files"),
    }
}

fn line_suffix(line: Option<usize>) -> String {
    line.map_or_else(String::new, |line| format!(":{line}"))
}

impl DataError {
    /// A [`DataError::Malformed`] about a whole file.
    pub fn malformed(path: &Path, reason: impl Into<String>, advice: impl Into<String>) -> Self {
        Self::Malformed { path: path.to_owned(), line: None, reason: reason.into(), advice: advice.into() }
    }

    /// A [`DataError::Malformed`] about one line (counted from 1) of a text file.
    pub fn at_line(path: &Path, line: usize, reason: impl Into<String>, advice: impl Into<String>) -> Self {
        Self::Malformed { path: path.to_owned(), line: Some(line), reason: reason.into(), advice: advice.into() }
    }

    /// A read failure: [`DataError::Missing`] when nothing is there, else [`DataError::Read`]. `what` says what was wanted.
    pub fn read(path: &Path, what: &str, source: io::Error) -> Self {
        if source.kind() == io::ErrorKind::NotFound {
            return Self::Missing { path: path.to_owned(), what: what.to_owned(), advice: "check the path".to_owned() };
        }
        Self::Read { path: path.to_owned(), source }
    }

    /// A write failure, with advice that fits the system's reason (no space, no permission, read-only file system).
    pub fn write(path: &Path, source: io::Error) -> Self {
        let advice = match source.kind() {
            io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => "free some space or write to another disk",
            io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => "choose a folder that may be written to",
            io::ErrorKind::NotFound => "create the parent folder first or choose another place",
            io::ErrorKind::NotADirectory | io::ErrorKind::AlreadyExists => "a file is in the way, choose another place",
            _ => "choose another place or check the disk",
        };
        Self::Write { path: path.to_owned(), source, advice: advice.to_owned() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_name_place_reason_and_advice() {
        let error = DataError::at_line(Path::new("poses/09.txt"), 17, "non-finite value nan", "repair the line");
        assert_eq!(error.to_string(), "poses/09.txt:17: non-finite value nan; repair the line");
        let error = DataError::malformed(Path::new("a.png"), "truncated image", "copy it again");
        assert_eq!(error.to_string(), "a.png: truncated image; copy it again");
    }

    #[test]
    fn write_advice_fits_the_reason() {
        let message = |kind: io::ErrorKind| DataError::write(Path::new("out"), io::Error::from(kind)).to_string();
        assert!(message(io::ErrorKind::StorageFull).contains("free some space"));
        assert!(message(io::ErrorKind::ReadOnlyFilesystem).contains("may be written to"));
    }

    #[test]
    fn read_tells_missing_from_unreadable() {
        let read = |kind: io::ErrorKind| DataError::read(Path::new("x"), "calib.txt", io::Error::from(kind));
        assert!(matches!(read(io::ErrorKind::NotFound), DataError::Missing { .. }));
        assert!(matches!(read(io::ErrorKind::PermissionDenied), DataError::Read { .. }));
    }
}
