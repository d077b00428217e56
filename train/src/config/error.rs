//! What can be wrong with a configuration.

use std::fmt::Display;
use std::io;
use std::path::PathBuf;

use thiserror::Error;

/// A configuration that cannot be used. Every message says what to change.
#[derive(Debug, Error)]
pub enum ConfigError {
    /// The file could not be read.
    #[error("{}: the configuration cannot be read ({source}); check the path given to --config", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        #[source]
        source: io::Error,
    },
    /// The text is not TOML, or lacks a part of a stage.
    #[error("{}{}: {reason}", path.display(), at(*line))]
    Syntax {
        /// The file.
        path: PathBuf,
        /// Line, from 1; 0 where there is no file.
        line: usize,
        /// What the parser found.
        reason: String,
    },
    /// A value of the wrong kind, for instance a text in place of a number.
    #[error("{}{}: {key} must be {kind}; {advice}", path.display(), at(*line))]
    WrongKind {
        /// The file.
        path: PathBuf,
        /// Line, from 1; 0 where there is no file.
        line: usize,
        /// The key with its table.
        key: String,
        /// What the value must be, for instance `a whole number, 0 or more`.
        kind: &'static str,
        /// What to write instead.
        advice: String,
    },
    /// A key that does not exist.
    #[error("{}{}: unknown key '{key}'; {}", path.display(), at(*line), advice(nearest.as_deref(), known))]
    UnknownKey {
        /// The file.
        path: PathBuf,
        /// Line, from 1; 0 where there is no file.
        line: usize,
        /// The key as written.
        key: String,
        /// The existing key that looks most like it, with its table when that is another one.
        nearest: Option<String>,
        /// All keys that the table has.
        known: Vec<String>,
    },
    /// A name of a choice that does not exist.
    #[error("{}{}: unknown value '{value}'; {}", path.display(), at(*line), advice(nearest.as_deref(), known))]
    UnknownName {
        /// The file.
        path: PathBuf,
        /// Line, from 1; 0 where there is no file.
        line: usize,
        /// The value as written.
        value: String,
        /// The existing value that looks most like it.
        nearest: Option<String>,
        /// All values that can stand here.
        known: Vec<String>,
    },
    /// The configuration of a run lacks a setting, as those that earlier versions wrote do.
    #[error("{}: '{key}' is missing; the run was made by another version of dimode, whose behaviour the file does not name. Add the line with the value that means what the run was trained with (a new run has {default}), or train again", path.display())]
    MissingKey {
        /// The file.
        path: PathBuf,
        /// The key with its table.
        key: String,
        /// The value that a new run has.
        default: String,
    },
    /// A value outside its range.
    #[error("{key} = {value}: {advice}")]
    Value {
        /// The key with its table, for instance `train.steps`.
        key: &'static str,
        /// The value as given.
        value: String,
        /// What the value must be.
        advice: String,
    },
}

fn at(line: usize) -> String {
    if line == 0 { String::new() } else { format!(":{line}") }
}

fn advice(nearest: Option<&str>, known: &[String]) -> String {
    match nearest {
        Some(name) => format!("did you mean '{name}'?"),
        None => format!("known here: {}", known.join(", ")),
    }
}

/// [`ConfigError::Value`] unless `ok`.
pub(super) fn require(ok: bool, key: &'static str, value: impl Display, advice: &str) -> Result<(), ConfigError> {
    if ok {
        return Ok(());
    }
    Err(ConfigError::Value { key, value: value.to_string(), advice: advice.to_owned() })
}

/// Finite and at least zero.
pub(super) fn not_negative(key: &'static str, value: f64) -> Result<(), ConfigError> {
    require(value.is_finite() && value >= 0.0, key, value, "must be a finite number, 0 or more")
}

/// Finite and above zero.
pub(super) fn positive(key: &'static str, value: f64) -> Result<(), ConfigError> {
    require(value.is_finite() && value > 0.0, key, value, "must be a finite number above 0")
}

/// Between 0 and 1, both allowed.
pub(super) fn fraction(key: &'static str, value: f64) -> Result<(), ConfigError> {
    require((0.0..=1.0).contains(&value), key, value, "must be between 0 and 1")
}
