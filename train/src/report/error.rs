//! What can go wrong while a report is made or written.

use std::path::PathBuf;

use thiserror::Error;

use crate::data::DataError;

/// A failure to make or write a report.
#[derive(Debug, Error)]
pub enum ReportError {
    /// A file could not be written; it is left as it was.
    #[error(transparent)]
    Write(#[from] DataError),
    /// The page template failed.
    #[error("report page: {source}; this is a fault of the program, please report it")]
    Template {
        /// What the template engine says.
        #[from]
        source: minijinja::Error,
    },
    /// A result has no JSON form.
    #[error("{}: {source}; the result cannot be written as JSON", path.display())]
    Json {
        /// The file that was to be written.
        path: PathBuf,
        /// What the JSON writer says.
        source: serde_json::Error,
    },
}
