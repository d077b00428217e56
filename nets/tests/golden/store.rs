//! Finds and reads golden files.

use std::collections::BTreeMap;
use std::env;
use std::path::PathBuf;

use dimode_autodiff::{Scalar, Shape, Tensor};
use dimode_nets::weights::{self, StoredTensor};
use serde_json::Value;

const IN_TREE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/golden/networks");
const BESIDE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/golden/networks");

/// The path of a golden file, if it is on this machine.
pub fn find(file: &str) -> Option<PathBuf> {
    let named = env::var_os("DIMODE_GOLDEN").map(PathBuf::from);
    let folders = [Some(IN_TREE.into()), named, Some(BESIDE.into())];
    let candidates = folders.into_iter().flatten();
    candidates.flat_map(|folder| [folder.join(file), folder.join("networks").join(file)]).find(|path| path.is_file())
}

/// True when the golden set is there; says so on standard error when it is not.
pub fn available(name: &str) -> bool {
    let found = find(&format!("{name}.safetensors")).is_some();
    if !found {
        eprintln!("skipped: {name}.safetensors not found; set DIMODE_GOLDEN to its folder");
    }
    found
}

/// The tensors of one golden file by name.
pub struct Golden {
    tensors: BTreeMap<String, StoredTensor>,
}

impl Golden {
    /// Reads `<name>.safetensors`.
    pub fn read(name: &str) -> Self {
        let path = find(&format!("{name}.safetensors")).expect("golden file");
        let tensors = weights::read(&path).expect("readable golden file");
        let named = |t: StoredTensor| (t.name.clone(), t);
        Self { tensors: tensors.into_iter().map(named).collect() }
    }

    pub fn get(&self, name: &str) -> Option<&StoredTensor> {
        self.tensors.get(name)
    }

    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.tensors.keys().map(String::as_str)
    }

    /// A network input, (N, C, H, W).
    pub fn input<T: Scalar>(&self, name: &str) -> Tensor<T> {
        let stored = &self.tensors[name];
        let [n, c, h, w] = stored.dims[..] else {
            panic!("{name} has dimensions {:?}", stored.dims);
        };
        let values = stored.values.iter().map(|&v| T::from_f64(v)).collect();
        Tensor::from_vec(Shape::new(n, c, h, w), values)
    }
}

/// The manifest of a golden set.
pub fn manifest(name: &str) -> Value {
    let path = find(&format!("manifest_{name}.json")).expect("manifest");
    let text = std::fs::read_to_string(path).expect("readable manifest");
    serde_json::from_str(&text).expect("manifest in JSON")
}

/// The weight gain of one checkpoint file in a manifest.
pub fn gain(manifest: &Value, file: &str) -> f64 {
    manifest[file]["gain"].as_f64().expect("gain in manifest")
}
