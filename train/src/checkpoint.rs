//! Checkpoints: all tensors and all state that the next step depends on, in one safetensors file.
//!
//! The tensors are ordinary safetensors entries of type F32. Everything else (step, schedule, generator state) is JSON under
//! the single metadata key `dimode`, beside a format number and a checksum. Nothing in the file depends on time, place or
//! number of threads, so equal content gives equal bytes.

mod error;
mod hash;

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::Read;
use std::path::Path;

use dimode_autodiff::{Shape, Tensor};
use dimode_nets::replace_file;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde_json::{Value, json};

pub use error::CheckpointError;
pub use hash::{Fnv, hash};

/// Number of the layout below the metadata key; a reader refuses any other.
const FORMAT: u64 = 1;
/// The one metadata key.
const KEY: &str = "dimode";
/// Longest accepted header in bytes, far above what the largest network needs.
const MAX_HEADER: u64 = 16 << 20;
/// Longest accepted file in bytes.
const MAX_FILE: u64 = 16 << 30;

/// Everything that the next step depends on.
#[derive(Clone, Debug)]
pub struct Checkpoint {
    /// Name, stored dimensions (rank 0 to 4) and values of each tensor. Names differ; reading returns them in the order of
    /// their names. Values of rank 1 have shape (1, C, 1, 1), of rank 2 (1, 1, rows, columns), of rank 3 (1, a, b, c).
    pub tensors: Vec<(String, Vec<usize>, Tensor<f32>)>,
    /// All other state: whole numbers, text, lists, objects. Object keys are written in sorted order. Fractions may lose bits
    /// on the way through JSON and are refused: store `f64::to_bits`, or a tensor.
    pub state: Value,
}

impl Checkpoint {
    /// Writes the file so that `path` holds the previous checkpoint until the new one is complete: a temporary file in the
    /// same folder is written and synced, renamed, and the folder is synced.
    ///
    /// **Errors** [`CheckpointError::Write`] with the system's reason (no space, read-only, a file in the way); the previous
    /// checkpoint is untouched then.
    ///
    /// **Panics** when two tensors have one name, dimensions and number of values differ, or the state holds a fraction.
    #[track_caller]
    pub fn write(&self, path: &Path) -> Result<(), CheckpointError> {
        let bytes = self.to_bytes(path)?;
        replace_file(path, &bytes).map_err(|source| CheckpointError::write(path, source))
    }

    /// Reads a file that [`Checkpoint::write`] wrote.
    ///
    /// **Errors** [`CheckpointError::Read`] when the system refuses, [`CheckpointError::Format`] when the file is cut short,
    /// damaged, or not a checkpoint. No more memory is taken than a few times the size of the file.
    pub fn read(path: &Path) -> Result<Self, CheckpointError> {
        let bytes = read_bounded(path)?;
        Self::parse(&bytes, path)
    }

    /// Reads a checkpoint from memory; `path` is used in messages.
    ///
    /// **Errors** [`CheckpointError::Format`].
    pub fn parse(bytes: &[u8], path: &Path) -> Result<Self, CheckpointError> {
        let refuse = |reason: String| CheckpointError::format(path, reason);
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(|error| refuse(error.to_string()))?;
        let text = header.metadata().as_ref().and_then(|map| map.get(KEY));
        let text = text.ok_or_else(|| refuse("a safetensors file, but without training state".to_owned()))?;
        let meta: Value = serde_json::from_str(text).map_err(|error| refuse(format!("training state: {error}")))?;
        let format = meta.get("format").and_then(Value::as_u64);
        if format != Some(FORMAT) {
            return Err(refuse(format!("layout {format:?}, this program reads layout {FORMAT}")));
        }
        let file = SafeTensors::deserialize(bytes).map_err(|error| refuse(error.to_string()))?;
        let mut views = file.tensors();
        views.sort_by(|a, b| a.0.cmp(&b.0));
        let state = meta.get("state").cloned().unwrap_or(Value::Null);
        let checksum = checksum(views.iter().map(|(name, view)| (name.as_str(), view.data())), &state);
        if meta.get("checksum").and_then(Value::as_str) != Some(&checksum) {
            return Err(refuse("the checksum does not fit the content: the file is damaged".to_owned()));
        }
        let tensors = views.into_iter().map(|(name, view)| decode(name, &view, path));
        Ok(Self { tensors: tensors.collect::<Result<_, _>>()?, state })
    }

    #[track_caller]
    fn to_bytes(&self, path: &Path) -> Result<Vec<u8>, CheckpointError> {
        let mut encoded: BTreeMap<&str, (&[usize], Vec<u8>)> = BTreeMap::new();
        for (name, dims, tensor) in &self.tensors {
            let count: usize = dims.iter().product();
            let held = tensor.data().len();
            assert_eq!(count, held, "checkpoint: '{name}' has dimensions {dims:?} but {held} values");
            let bytes = tensor.data().iter().flat_map(|value| value.to_le_bytes()).collect();
            let before = encoded.insert(name, (dims, bytes));
            assert!(before.is_none(), "checkpoint: two tensors are called '{name}'");
        }
        let state = sorted(&self.state);
        assert!(!holds_fraction(&state), "checkpoint: the state holds a fraction, store f64::to_bits: {state}");
        let checksum = checksum(encoded.iter().map(|(name, (_, bytes))| (*name, bytes.as_slice())), &state);
        let meta = sorted(&json!({ "format": FORMAT, "checksum": checksum, "state": state }));
        let refuse = |error: safetensors::SafeTensorError| CheckpointError::format(path, error.to_string());
        let views = encoded.iter().map(|(name, (dims, bytes))| Ok((*name, TensorView::new(Dtype::F32, dims.to_vec(), bytes)?)));
        let views = views.collect::<Result<Vec<_>, _>>().map_err(refuse)?;
        // One key only: with more, the order of the map would show in the bytes.
        let metadata = HashMap::from([(KEY.to_owned(), meta.to_string())]);
        safetensors::serialize(views, Some(metadata)).map_err(refuse)
    }
}

/// Reads the file after its length and the length of its header proved believable.
fn read_bounded(path: &Path) -> Result<Vec<u8>, CheckpointError> {
    let fail = |source| CheckpointError::read(path, source);
    let refuse = |reason: String| Err(CheckpointError::format(path, reason));
    let mut file = File::open(path).map_err(fail)?;
    let info = file.metadata().map_err(fail)?;
    if !info.is_file() {
        return refuse("not a regular file".to_owned());
    }
    let len = info.len();
    if len < 8 {
        return refuse(format!("only {len} bytes long: cut short"));
    }
    let mut head = [0_u8; 8];
    file.read_exact(&mut head).map_err(fail)?;
    let header = u64::from_le_bytes(head);
    if header > MAX_HEADER || len > MAX_FILE {
        return refuse("not a safetensors file (no believable header)".to_owned());
    }
    if header > len - 8 {
        return refuse(format!("cut short: header of {header} bytes in a file of {len} bytes"));
    }
    let mut bytes = Vec::with_capacity(len as usize);
    bytes.extend_from_slice(&head);
    file.take(len - 8).read_to_end(&mut bytes).map_err(fail)?;
    Ok(bytes)
}

fn decode(name: String, view: &TensorView, path: &Path) -> Result<(String, Vec<usize>, Tensor<f32>), CheckpointError> {
    let dims = view.shape().to_vec();
    let shape = shape_of(&dims).filter(|_| view.dtype() == Dtype::F32);
    let Some(shape) = shape else {
        let reason = format!("'{name}' is {:?} {dims:?}, expected F32 with at most four axes", view.dtype());
        return Err(CheckpointError::format(path, reason));
    };
    let values = view.data().as_chunks::<4>().0.iter().map(|&b| f32::from_le_bytes(b)).collect();
    Ok((name, dims, Tensor::from_vec(shape, values)))
}

/// None for more than four axes.
fn shape_of(dims: &[usize]) -> Option<Shape> {
    Some(match *dims {
        [] => Shape::new(1, 1, 1, 1),
        [c] => Shape::new(1, c, 1, 1),
        [rows, columns] => Shape::new(1, 1, rows, columns),
        [a, b, c] => Shape::new(1, a, b, c),
        [n, c, h, w] => Shape::new(n, c, h, w),
        _ => return None,
    })
}

/// Hash of names, bytes and state, as sixteen hexadecimal digits. `tensors` come in the order of their names.
fn checksum<'a>(tensors: impl Iterator<Item = (&'a str, &'a [u8])>, state: &Value) -> String {
    let mut hash = Fnv::default();
    for (name, bytes) in tensors {
        hash.add(name.as_bytes());
        hash.add(bytes);
    }
    hash.add(sorted(state).to_string().as_bytes());
    hash.hex()
}

fn holds_fraction(value: &Value) -> bool {
    match value {
        Value::Number(number) => number.is_f64(),
        Value::Array(items) => items.iter().any(holds_fraction),
        Value::Object(map) => map.values().any(holds_fraction),
        _ => false,
    }
}

/// The same value with the keys of every object in sorted order, whatever map the JSON library was built with.
fn sorted(value: &Value) -> Value {
    match value {
        Value::Object(map) => {
            let ordered: BTreeMap<&String, Value> = map.iter().map(|(key, inner)| (key, sorted(inner))).collect();
            Value::Object(ordered.into_iter().map(|(key, inner)| (key.clone(), inner)).collect())
        }
        Value::Array(items) => Value::Array(items.iter().map(sorted).collect()),
        other => other.clone(),
    }
}

#[cfg(test)]
mod tests;
