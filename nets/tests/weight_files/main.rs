//! Files of weights from outside: what PyTorch writes, and what nobody should.

mod archive;
mod hostile;
mod random;
mod torch;

use std::path::PathBuf;

use dimode_nets::weights::{self, StoredTensor, WeightFile};

fn path(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/data/weights").join(name)
}

fn bytes(name: &str) -> Vec<u8> {
    std::fs::read(path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

#[track_caller]
fn read(name: &str) -> WeightFile {
    weights::open(&path(name)).unwrap_or_else(|error| panic!("{error}"))
}

#[track_caller]
fn tensor<'a>(file: &'a WeightFile, name: &str) -> &'a StoredTensor {
    file.tensors.iter().find(|tensor| tensor.name == name).unwrap_or_else(|| panic!("no {name}"))
}

/// Why bytes are refused.
#[track_caller]
fn refusal(bytes: &[u8]) -> String {
    weights::parse_file(bytes, "file").expect_err("refused").to_string()
}

/// The values of the fixtures: i / 8 - 1.
fn ramp(count: usize) -> Vec<f64> {
    (0..count).map(|i| i as f64 / 8.0 - 1.0).collect()
}
