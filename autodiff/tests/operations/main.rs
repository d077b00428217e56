//! Tests of the operations from outside. One program, because every program compiles every operation again.

mod determinism;
mod determinism_spatial;
mod kinks;
mod network_shapes;

/// An operation whose work fits one piece shows nothing about threads, so each must be called in a test over several pieces.
#[test]
fn every_operation_is_tested_for_the_same_bits() {
    let tests = [include_str!("determinism.rs"), include_str!("determinism_spatial.rs")].concat();
    let proofs = dimode_autodiff::proof::all();
    let missing: Vec<&str> = proofs.iter().map(|p| p.op()).filter(|op| !tests.contains(&format!("{op}("))).collect();
    assert!(missing.is_empty(), "operations without a test: {missing:?}");
}
