//! Every operation is proved, and every planted fault is caught.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use dimode_autodiff::par;
use dimode_autodiff::proof::{Case, Fault, all, mutations};

#[test]
fn every_operation_agrees_with_its_oracles() {
    let failures: Vec<String> = all().iter().map(|p| p.check()).filter(|r| !r.is_ok()).map(|r| r.to_string()).collect();
    assert!(failures.is_empty(), "{}", failures.concat());
}

#[test]
fn every_operation_has_a_small_case_for_differences_and_one_of_two_thousand_entries() {
    let without = |has: fn(&Case) -> bool| -> Vec<&str> {
        all().iter().filter(|proof| !proof.cases().iter().any(has)).map(|proof| proof.op()).collect()
    };
    assert_eq!(without(|case| case.is_small()), [""; 0], "no case is compared with differences");
    assert_eq!(without(|case| case.largest() >= 2000), [""; 0], "no input of 2000 entries");
}

#[test]
fn every_planted_fault_is_caught() {
    for proof in all() {
        let found = mutations(&proof);
        assert!(!found.is_empty(), "{}: no backward rule ran", proof.op());
        for m in found {
            assert!(!m.is_missed(), "missed: {m:?}");
            // An exchange or a border may be lost on the few small cases that differences see.
            let whole = [Fault::Factor, Fault::Sign, Fault::Entry].contains(&m.fault);
            assert!(!whole || m.tried_by_differences > 0, "never shown to differences: {m:?}");
            // Every rule has a gradient to spoil; only an exchange can make no difference, where all entries are equal.
            assert!(m.fault == Fault::Swap || !m.is_void(), "nothing to spoil: {m:?}");
        }
    }
}

#[test]
fn no_operation_hides_what_is_not_a_number() {
    let hidden: Vec<String> = all().iter().flat_map(|proof| proof.hidden_nan()).collect();
    assert!(hidden.is_empty(), "{hidden:#?}");
}

#[test]
fn every_case_gives_the_same_bits_on_any_number_of_threads_and_again() {
    for proof in all() {
        let one = par::with_threads(1, || proof.bits());
        for threads in [1, 2, 3, 4] {
            assert!(par::with_threads(threads, || proof.bits()) == one, "{}: {threads} threads", proof.op());
        }
    }
}

#[test]
fn every_operation_of_the_index_has_a_proof() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/ops");
    let mut methods = BTreeSet::new();
    for file in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).filter(|p| p.extension().is_some()) {
        let text = fs::read_to_string(file).unwrap();
        let operations = text.split("\nimpl<").skip(1).filter(|rest| rest.lines().next().unwrap().contains("> Var<'"));
        for block in operations.map(|rest| rest.split("\n}\n").next().unwrap()) {
            let names = block.split("\n    pub fn ").skip(1).map(|rest| rest.split('(').next().unwrap().to_string());
            methods.extend(names);
        }
    }
    assert!(methods.contains("conv2d") && methods.contains("abs"), "{methods:?}");
    let proved: BTreeSet<String> = all().iter().map(|proof| proof.op().to_string()).collect();
    let missing: Vec<_> = methods.difference(&proved).collect();
    assert!(missing.is_empty(), "operations without a proof: {missing:?}");
}
