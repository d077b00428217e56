//! Where golden files lie.

use std::env;
use std::fs;
use std::path::PathBuf;

use serde_json::Value;

/// Environment variable with the path of a folder of further golden files, arranged in sub-folders as `golden/` is.
pub const FURTHER_SETS: &str = "DIMODE_GOLDEN";

const IN_TREE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/golden");

/// The path of a golden file such as `losses/pose.f64.safetensors`: in this crate, or else in the folder named by
/// [`FURTHER_SETS`]. `None` when neither has it.
pub fn find(file: &str) -> Option<PathBuf> {
    let further = env::var_os(FURTHER_SETS).map(PathBuf::from);
    [Some(IN_TREE.into()), further].into_iter().flatten().map(|folder| folder.join(file)).find(|path| path.is_file())
}

/// True when the file is there; says so on standard error when it is not.
pub fn available(file: &str) -> bool {
    let found = find(file).is_some();
    if !found {
        eprintln!("skipped: golden file {file} not found; set {FURTHER_SETS} to the folder that holds it");
    }
    found
}

/// The path of a golden file.
///
/// # Panics
/// When [`find`] does not find it.
#[track_caller]
pub fn path(file: &str) -> PathBuf {
    find(file).unwrap_or_else(|| {
        let further = env::var(FURTHER_SETS).unwrap_or_else(|_| "not set".to_owned());
        panic!(
            "golden file {file} is missing: looked in {IN_TREE} and in {FURTHER_SETS} ({further}); \
             restore it with `git checkout -- tests/golden`, or set {FURTHER_SETS} to the folder that holds it"
        )
    })
}

/// The content of a golden JSON file.
///
/// # Panics
/// When the file is missing, cannot be read or is not JSON.
#[track_caller]
pub fn json(file: &str) -> Value {
    serde_json::from_slice(&bytes(file)).unwrap_or_else(|e| panic!("golden file {file} is not JSON: {e}; restore it"))
}

#[track_caller]
pub(crate) fn bytes(file: &str) -> Vec<u8> {
    let path = path(file);
    fs::read(&path).unwrap_or_else(|e| panic!("cannot read golden file {}: {e}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_the_crate_are_found_and_others_are_not() {
        assert!(path("losses/pose.f64.safetensors").is_file());
        assert!(!available("losses/no_such_set.safetensors"));
        assert!(json("evaluation/depth.json")["garg_median_80"].is_object());
    }

    #[test]
    #[should_panic(expected = "golden file losses/no_such_set.safetensors is missing: looked in")]
    fn a_missing_file_is_named_with_the_places_searched() {
        path("losses/no_such_set.safetensors");
    }

    #[test]
    #[should_panic(expected = "golden file losses/README.md is not JSON")]
    fn a_file_that_is_not_json_is_named() {
        json("losses/README.md");
    }
}
