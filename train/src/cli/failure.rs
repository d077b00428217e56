//! From an error to an exit code and one or two lines.

use std::io::{self, Write};
use std::process::ExitCode;

use dimode_nets::WeightError;
use thiserror::Error;

use crate::checkpoint::CheckpointError;
use crate::config::ConfigError;
use crate::data::DataError;
use crate::eval::EvalError;
use crate::non_finite::NonFinite;
use crate::pretrain::TargetError;
use crate::report::ReportError;
use crate::run::RunError;
use crate::run::first_weights::FirstWeightsError;
use crate::run::infer::InferError;
use crate::run::verify::UnknownClaim;
use crate::run::weights::{ConvertError, FileMisfit};

/// How the process ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    /// The work is done.
    Done,
    /// The work failed.
    Failed,
    /// The command or the configuration cannot work.
    Usage,
    /// Stopped on request, after saving.
    Interrupted,
}

impl Exit {
    /// 0, 1, 2 or 130.
    pub fn code(self) -> ExitCode {
        ExitCode::from(match self {
            Self::Done => 0,
            Self::Failed => 1,
            Self::Usage => 2,
            Self::Interrupted => 130,
        })
    }
}

/// Flags that are fine one by one, but not together or not with what they name.
#[derive(Debug, Error)]
#[error("{what}; {advice}")]
pub struct UsageError {
    /// What does not fit.
    pub what: String,
    /// What to write instead.
    pub advice: String,
}

impl UsageError {
    /// A usage error from its two parts.
    pub fn new(what: impl Into<String>, advice: impl Into<String>) -> Self {
        Self { what: what.into(), advice: advice.into() }
    }
}

/// Prints the error and gives the exit code that belongs to it.
pub fn tell(error: &anyhow::Error) -> Exit {
    if is_closed_pipe(error) {
        return Exit::Done;
    }
    // Standard error may be closed, too; the exit code is all that is left then.
    let _ = writeln!(io::stderr(), "{}{}", misfits(error), message(error));
    if is_usage(error) { Exit::Usage } else { Exit::Failed }
}

/// The reader of our standard output went away, as `head` does: not a failure.
fn is_closed_pipe(error: &anyhow::Error) -> bool {
    let closed = |cause: &io::Error| cause.kind() == io::ErrorKind::BrokenPipe;
    error.chain().any(|cause| cause.downcast_ref().is_some_and(closed))
}

fn is_usage(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| {
        cause.is::<ConfigError>()
            || cause.is::<RunError>()
            || cause.is::<UsageError>()
            || cause.is::<UnknownClaim>()
            || cause.is::<TargetError>()
            || cause.downcast_ref().is_some_and(InferError::is_usage)
            || cause.downcast_ref().is_some_and(ConvertError::is_usage)
            || cause.downcast_ref().is_some_and(is_usage_of_data)
            || matches!(cause.downcast_ref(), Some(EvalError::Option { .. }))
    })
}

fn is_usage_of_data(error: &DataError) -> bool {
    use DataError::{NotEmpty, NotOurs, Occupied, Option, StagingTaken};
    matches!(error, Option { .. } | Occupied { .. } | NotOurs { .. } | NotEmpty { .. } | StagingTaken { .. })
}

/// Every difference of weights that do not fit a network, a line each, before the error that counts them.
fn misfits(error: &anyhow::Error) -> String {
    let listed = |cause: &(dyn std::error::Error + 'static)| {
        if let Some(ConvertError::Misfit { misfits, .. }) = cause.downcast_ref() {
            let of_file = |misfit: &FileMisfit| {
                let lines = misfit.differences.list();
                lines.lines().map(|line| format!("{} {line}\n", misfit.file)).collect::<String>()
            };
            return Some(misfits.iter().map(of_file).collect());
        }
        let boxed = || cause.downcast_ref::<Box<WeightError>>().map(AsRef::as_ref);
        match cause.downcast_ref::<WeightError>().or_else(boxed) {
            Some(WeightError::Mismatch { differences, .. }) => Some(differences.list()),
            _ => None,
        }
    };
    error.chain().find_map(listed).unwrap_or_default()
}

/// `error: what`, and `  fix: what to do` where the error tells.
fn message(error: &anyhow::Error) -> String {
    let mut parts: Vec<String> = Vec::new();
    for cause in error.chain() {
        let text = one_line(&cause.to_string());
        // Many messages already hold that of their source.
        if !parts.iter().any(|part| part.contains(&text)) {
            parts.push(text);
        }
    }
    let text = parts.join(": ");
    let advised = error.chain().any(has_advice).then(|| text.rsplit_once("; ")).flatten();
    match advised {
        Some((what, advice)) => format!("error: {what}\n  fix: {advice}"),
        None => format!("error: {text}"),
    }
}

/// Errors whose text after the last semicolon says what to do.
fn has_advice(cause: &(dyn std::error::Error + 'static)) -> bool {
    cause.is::<DataError>()
        || cause.is::<ConfigError>()
        || cause.is::<CheckpointError>()
        || cause.is::<RunError>()
        || cause.is::<FirstWeightsError>()
        || cause.is::<InferError>()
        || cause.is::<UsageError>()
        || cause.is::<UnknownClaim>()
        || cause.is::<TargetError>()
        || cause.is::<EvalError>()
        || cause.is::<ReportError>()
        || cause.is::<NonFinite>()
        || cause.is::<ConvertError>()
        || cause.is::<WeightError>()
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use anyhow::Context;

    use super::*;

    #[test]
    fn advice_stands_on_its_own_line() {
        let error = anyhow::Error::from(DataError::malformed(Path::new("a.png"), "truncated image", "copy it again"));
        assert_eq!(message(&error), "error: a.png: truncated image\n  fix: copy it again");
        assert!(!is_usage(&error));
    }

    #[test]
    fn causes_are_told_once() {
        let source = io::Error::from(io::ErrorKind::PermissionDenied);
        let error = anyhow::Error::from(DataError::write(Path::new("out"), source));
        assert_eq!(message(&error).matches("permission denied").count(), 1);
        let error = Err::<(), _>(error).context("writing the report").unwrap_err();
        assert!(message(&error).starts_with("error: writing the report: out: cannot be written"));
    }

    #[test]
    fn wrong_usage_and_failures_differ() {
        let usage = anyhow::Error::from(UsageError::new("no input", "name one"));
        assert!(is_usage(&usage));
        assert_eq!(message(&usage), "error: no input\n  fix: name one");
        let closed = anyhow::Error::from(io::Error::from(io::ErrorKind::BrokenPipe));
        assert_eq!(tell(&closed), Exit::Done);
    }
}
