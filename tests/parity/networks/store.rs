//! The files of one network: recorded tensors, and the manifest of its parameters.

use dimode_tests::Golden;
use serde_json::Value;

fn tensor_file(name: &str) -> String {
    format!("networks/{name}.safetensors")
}

/// True when the golden set is there; says so on standard error when it is not.
pub fn available(name: &str) -> bool {
    dimode_tests::available(&tensor_file(name))
}

/// Reads `<name>.safetensors`.
#[track_caller]
pub fn open(name: &str) -> Golden {
    Golden::open(&tensor_file(name))
}

/// The manifest of a golden set.
#[track_caller]
pub fn manifest(name: &str) -> Value {
    dimode_tests::json(&format!("networks/manifest_{name}.json"))
}

/// The weight gain of one checkpoint file in a manifest.
pub fn gain(manifest: &Value, file: &str) -> f64 {
    manifest[file]["gain"].as_f64().expect("gain in manifest")
}
