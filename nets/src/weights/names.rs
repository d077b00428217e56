//! Names in files that differ from those of the networks here.

use std::collections::BTreeMap;

use dimode_autodiff::Scalar;

use crate::Params;

/// A part of a name, and the part that stands for it here: the wide blocks of RAFT register the norm of their skip twice, so that
/// files hold one tensor under both names, or, where the writer has dropped one, under either.
const ALIASES: [(&str, &str); 1] = [(".downsample.1.", ".norm3.")];

/// Renames what is stored under a second name of a tensor of `params`, or drops it when the first name is there, too.
///
/// A name that the network itself has stays: in ResNets `downsample.1` is a norm of its own.
pub(super) fn resolve_aliases<T: Scalar, V>(params: &Params<T>, given: &mut BTreeMap<String, V>) {
    let unknown: Vec<String> = given.keys().filter(|name| params.get(name).is_none()).cloned().collect();
    for alias in unknown {
        let mut first = ALIASES.iter().map(|&(second, first)| alias.replace(second, first));
        let first = first.find(|name| *name != alias && params.get(name).is_some());
        if let Some(first) = first
            && let Some(value) = given.remove(&alias)
        {
            given.entry(first).or_insert(value);
        }
    }
}
