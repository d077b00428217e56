//! Every operation is proved, and every planted fault is caught.

use dimode_autodiff::proof::{Fault, all, mutations};

#[test]
fn every_operation_agrees_with_its_oracles() {
    let failures: Vec<String> = all().iter().map(|p| p.check()).filter(|r| !r.is_ok()).map(|r| r.to_string()).collect();
    assert!(failures.is_empty(), "{}", failures.concat());
}

#[test]
fn every_planted_fault_is_caught() {
    for proof in all() {
        let found = mutations(&proof);
        assert!(!found.is_empty(), "{}: no backward rule ran", proof.op());
        for m in found {
            assert!(!m.is_missed(), "missed: {m:?}");
            // Every rule has a gradient to spoil; only an exchange can make no difference, where all entries are equal.
            assert!(m.fault == Fault::Swap || !m.is_void(), "nothing to spoil: {m:?}");
        }
    }
}
