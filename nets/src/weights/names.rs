//! Names in files that differ from those of the networks here.

use std::collections::BTreeMap;

use super::{StoredTensor, WeightError};
/// Suffix of a counter that the reference modules store and nothing here uses.
const COUNTER: &str = "num_batches_tracked";

/// What wrappers put before every name: training on several devices, and compiling. Both may have wrapped more than once.
const WRAPPERS: [&str; 2] = ["module.", "_orig_mod."];

/// A part of a name, and the part that stands for it here: the wide blocks of RAFT register the norm of their skip twice, so that
/// files hold one tensor under both names, or, where the writer has dropped one, under either.
const ALIASES: [(&str, &str); 1] = [(".downsample.1.", ".norm3.")];

/// Whether a name is that of a counter of batches.
pub(super) fn is_counter(name: &str) -> bool {
    name.rsplit('.').next() == Some(COUNTER)
}

/// The name without what wrappers put before it.
pub fn plain_name(name: &str) -> &str {
    let mut plain = name;
    while let Some(rest) = WRAPPERS.iter().find_map(|wrapper| plain.strip_prefix(wrapper)) {
        plain = rest;
    }
    plain
}

/// The tensors by their plain names.
///
/// # Errors
/// [`WeightError::Twice`] when two have the same.
pub fn by_plain_name(tensors: Vec<StoredTensor>, origin: &str) -> Result<BTreeMap<String, StoredTensor>, WeightError> {
    let mut by_name: BTreeMap<String, StoredTensor> = BTreeMap::new();
    for tensor in tensors {
        let name = plain_name(&tensor.name).to_owned();
        if let Some(first) = by_name.get(&name) {
            let (first, second) = (first.name.clone(), tensor.name);
            return Err(WeightError::Twice { origin: origin.to_owned(), name, first, second });
        }
        by_name.insert(name, tensor);
    }
    Ok(by_name)
}

/// Renames what is stored under a second name of a tensor that is known, or drops it when the first name is there, too.
///
/// A name that is known itself stays: in ResNets `downsample.1` is a norm of its own.
pub fn resolve_aliases<V>(known: impl Fn(&str) -> bool, given: &mut BTreeMap<String, V>) {
    let unknown: Vec<String> = given.keys().filter(|name| !known(name)).cloned().collect();
    for alias in unknown {
        let mut first = ALIASES.iter().map(|&(second, first)| alias.replace(second, first));
        let first = first.find(|name| *name != alias && known(name));
        if let Some(first) = first
            && let Some(value) = given.remove(&alias)
        {
            given.entry(first).or_insert(value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::ElementType;
    use super::*;

    #[test]
    fn wrappers_are_taken_off_at_the_front_alone() {
        for name in ["a.module.b", "module.a.module.b", "module.module.a.module.b", "_orig_mod.module.a.module.b"] {
            assert_eq!(plain_name(name), "a.module.b");
        }
        assert_eq!((plain_name("modules.a"), plain_name("module.")), ("modules.a", ""));
    }

    #[test]
    fn counters_are_told_by_the_last_part_of_the_name() {
        assert!(is_counter("bn.num_batches_tracked") && is_counter("num_batches_tracked"));
        assert!(!is_counter("num_batches_tracked.weight") && !is_counter("my_num_batches_tracked"));
    }

    #[test]
    fn a_name_that_comes_twice_is_an_error() {
        let tensor =
            |name: &str| StoredTensor { name: name.to_owned(), element: ElementType::F32, dims: vec![], values: vec![1.0] };
        let error = by_plain_name(vec![tensor("a"), tensor("b"), tensor("module.a")], "file").unwrap_err();
        assert_eq!(error.to_string(), "file: 'a' and 'module.a' are the same tensor 'a'; keep one of them");
    }
}
