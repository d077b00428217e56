//! Where the functions that claims name lie in the tree.

use dimode_geometry::ledger::Claim;

/// Root of the crate that claims talk about.
const ROOT: &str = "geometry/src";

/// Modules whose own file is `mod.rs` in their folder.
const FOLDERS: [&str; 6] = ["flow", "ledger", "ledger/forward", "loss_forms", "losses", "taped"];

/// Functions that are found a level higher than the file they lie in.
const RE_EXPORTS: [(&str, &str); 10] = [
    ("losses::axial", "losses/axial"),
    ("losses::planar", "losses/planar"),
    ("losses::radial", "losses/radial"),
    ("losses::tangential", "losses/tangential"),
    ("taped::align", "taped/alignment"),
    ("taped::rigid_flow", "taped/rigid_flow"),
    ("taped::so3_exp", "taped/so3_exp"),
    ("taped::source_from_target", "taped/pose"),
    ("taped::translation_in_target_frame", "taped/alignment"),
    ("taped::warp", "taped/warp"),
];

/// File of a function or constant of the geometry crate, from the root of the repository: `flow::radial::radial_flow` lies in
/// `geometry/src/flow/radial.rs`, `camera::Intrinsics::ray` in `geometry/src/camera.rs`.
pub fn function_file(path: &str) -> String {
    if let Some((_, file)) = RE_EXPORTS.iter().find(|(name, _)| *name == path) {
        return format!("{ROOT}/{file}.rs");
    }
    let parts: Vec<&str> = path.split("::").collect();
    let is_type = |part: &&str| part.starts_with(|c: char| c.is_ascii_uppercase());
    let modules = parts.iter().position(is_type).unwrap_or(parts.len().saturating_sub(1));
    let module = parts[..modules].join("/");
    if FOLDERS.contains(&module.as_str()) { format!("{ROOT}/{module}/mod.rs") } else { format!("{ROOT}/{module}.rs") }
}

/// File of a claim: its statement, its check and its property tests.
pub fn check_file(claim: &Claim) -> String {
    format!("{ROOT}/ledger/claims/{}_{}.rs", claim.id.to_lowercase(), claim.slug.to_lowercase().replace('-', "_"))
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::{Path, PathBuf};

    use dimode_geometry::ledger;

    use super::*;

    fn in_tree(file: &str) -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(file)
    }

    /// The part of a file from `impl Type` on, or all of it for a free function or constant.
    fn scope<'a>(text: &'a str, path: &str) -> Option<&'a str> {
        let parts: Vec<&str> = path.split("::").collect();
        let owner = parts[..parts.len() - 1].iter().find(|part| part.starts_with(|c: char| c.is_ascii_uppercase()));
        let Some(owner) = owner else { return Some(text) };
        let begins = |line: &str| line.starts_with("impl") && line.contains(*owner);
        let at = text.lines().scan(0, |at, line| {
            let start = *at;
            *at += line.len() + 1;
            Some((start, line))
        });
        at.filter(|(_, line)| begins(line)).map(|(start, _)| &text[start..]).next()
    }

    #[test]
    fn paths_of_modules_types_and_folders() {
        assert_eq!(function_file("flow::radial::radial_flow"), "geometry/src/flow/radial.rs");
        assert_eq!(function_file("camera::Intrinsics::ray"), "geometry/src/camera.rs");
        assert_eq!(function_file("taped::align"), "geometry/src/taped/alignment.rs");
        assert_eq!(function_file("ledger::forward::jacobian"), "geometry/src/ledger/forward/mod.rs");
        assert_eq!(function_file("ledger::EXTRA"), "geometry/src/ledger/mod.rs");
        assert_eq!(check_file(ledger::find("L09").unwrap()), "geometry/src/ledger/claims/l09_rot_flow_inline.rs");
    }

    /// Asserts that a function or constant is declared in the file that its path leads to.
    fn assert_declared(who: &str, path: &str) {
        let file = function_file(path);
        let text = fs::read_to_string(in_tree(&file));
        let text = text.unwrap_or_else(|_| panic!("{who}: '{path}' should be in {file}; name the module it lies in"));
        let name = path.rsplit("::").next().unwrap_or(path);
        let forms = [format!("fn {name}("), format!("fn {name}<"), format!("const {name}:")];
        let declared = |scope: &str| forms.iter().any(|form| scope.contains(form));
        assert!(scope(&text, path).is_some_and(declared), "{who}: no 'fn {name}' of '{path}' in {file}");
    }

    #[test]
    fn every_function_that_a_claim_or_an_equation_names_is_in_its_file() {
        for claim in ledger::all() {
            assert!(in_tree(&check_file(claim)).is_file(), "{} is not in {}", claim.id, check_file(claim));
            assert!(!claim.functions.is_empty(), "{} names no function", claim.id);
            claim.functions.iter().chain(claim.taped).for_each(|path| assert_declared(claim.id, path));
        }
        for equation in ledger::EQUATIONS {
            equation.functions.iter().chain(equation.taped).for_each(|path| assert_declared(equation.label, path));
        }
    }

    #[test]
    fn every_claim_about_samples_has_property_tests() {
        // These two compare numbers that are printed in the paper: there is nothing to draw.
        let constants = ["L63", "L64"];
        for claim in ledger::all() {
            let text = fs::read_to_string(in_tree(&check_file(claim))).unwrap();
            let drawn = text.contains("proptest! {") || text.contains("tests_on_cases!(");
            let tested = drawn || constants.contains(&claim.id) && text.contains("#[test]");
            assert!(tested, "{} has no property test in {}", claim.id, check_file(claim));
        }
    }

    #[test]
    fn the_lists_of_folders_and_re_exports_are_those_of_the_tree() {
        for folder in FOLDERS {
            assert!(in_tree(&format!("{ROOT}/{folder}/mod.rs")).is_file(), "{folder}");
        }
        for (path, file) in RE_EXPORTS {
            let name = path.rsplit("::").next().unwrap();
            let text = fs::read_to_string(in_tree(&format!("{ROOT}/{file}.rs"))).unwrap();
            assert!(text.contains(&format!("pub fn {name}")), "{path}");
        }
    }
}
