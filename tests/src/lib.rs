//! Reference numbers with their origin, and the one loader that reads them.
//!
//! The numbers lie under `golden/`; the README of each folder says how they were made. Each folder has a test of its own,
//! named after what it proves:
//!
//! | folder | content | test |
//! |---|---|---|
//! | `golden/losses` | sampling, poses, masks and losses with their gradients | `loss_parity` |
//! | `golden/networks` | activations and gradients of networks | `network_parity` |
//! | `golden/derivations` | the paper's equations and claims | `derivation_parity` |
//! | `golden/evaluation` | depth and trajectory metrics | `evaluation_parity` |
//!
//! [`Golden`] reads tensors, [`json`] reads tables, and [`find`] says where a file lies. Their messages end a test, so they
//! panic. A set that is too large for the repository, or may not be part of it, is looked for in the folder named by
//! [`FURTHER_SETS`]; tests of it ask [`available`] first.

mod files;
mod golden;

pub use files::{FURTHER_SETS, available, find, json, path};
pub use golden::{Golden, Stored};
