//! Names of network sizes as text: one helper for all `FromStr` implementations.

use thiserror::Error;

/// A network size was asked for by a name that does not exist.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("unknown {what} '{given}'; use one of: {}", known.join(", "))]
pub struct UnknownName {
    /// What was to be named, for example "depth network".
    pub what: &'static str,
    /// The name as given.
    pub given: String,
    /// The names that exist.
    pub known: Vec<&'static str>,
}

/// Finds the variant whose name is `given`.
pub(crate) fn parse_name<K: Copy>(what: &'static str, given: &str, table: &[(&'static str, K)]) -> Result<K, UnknownName> {
    table.iter().find(|(name, _)| *name == given).map(|&(_, kind)| kind).ok_or_else(|| UnknownName {
        what,
        given: given.to_owned(),
        known: table.iter().map(|&(name, _)| name).collect(),
    })
}

/// The name of a variant in the same table.
#[track_caller]
pub(crate) fn name_of<K: Copy + PartialEq>(kind: K, table: &[(&'static str, K)]) -> &'static str {
    table.iter().find(|&&(_, k)| k == kind).map(|&(name, _)| name).expect("every variant is in its table of names")
}
