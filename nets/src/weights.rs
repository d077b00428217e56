//! Parameters in safetensors files: written atomically, read strictly.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use dimode_autodiff::{Scalar, Tensor};
use safetensors::tensor::{Dtype, SafeTensorError, SafeTensors, TensorView};
use thiserror::Error;

use crate::params::shape_of;
use crate::{ParamSet, Params, replace_file};

/// Suffix of a counter that the reference modules store and nothing here uses.
const COUNTER: &str = "num_batches_tracked";
/// Prefix added by the data-parallel wrapper of the reference.
const WRAPPER: &str = "module.";
/// How many differences of each kind a message names.
const NAMED: usize = 3;

/// A tensor whose dimensions differ from those the network expects.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Misshapen {
    /// Name inside the file.
    pub name: String,
    /// Dimensions the network expects.
    pub expected: Vec<usize>,
    /// Dimensions found in the file.
    pub found: Vec<usize>,
}

/// Why weights could not be read or written.
#[derive(Debug, Error)]
pub enum WeightError {
    /// The file could not be read.
    #[error("cannot read weights from {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The reason given by the system.
        source: io::Error,
    },
    /// The file could not be written.
    #[error("cannot write weights to {}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The reason given by the system.
        source: io::Error,
    },
    /// The content is not a well-formed safetensors file.
    #[error("{origin} is not a safetensors file: {source}")]
    Format {
        /// Where the bytes came from.
        origin: String,
        /// What the parser found.
        source: SafeTensorError,
    },
    /// A tensor is stored in a type other than f32 and f64.
    #[error("{origin}: '{name}' is stored as {dtype}; convert it to F32 or F64")]
    ElementType {
        /// Where the bytes came from.
        origin: String,
        /// Name inside the file.
        name: String,
        /// The stored type.
        dtype: String,
    },
    /// Names or dimensions differ from those of the network. The fields hold all differences; the message counts them and names
    /// the first few of each kind.
    #[error("{}", describe(origin, missing, extra, misshapen))]
    Mismatch {
        /// Where the tensors came from.
        origin: String,
        /// Names the network has and the file has not.
        missing: Vec<String>,
        /// Names the file has and the network has not.
        extra: Vec<String>,
        /// Tensors of the wrong size.
        misshapen: Vec<Misshapen>,
    },
    /// A weight is infinite or not a number, as a training that broke down leaves it.
    #[error("{origin}: '{name}' holds {value:e} at index {index}; make the weights again, by a training that stays finite")]
    NonFinite {
        /// Where the tensors came from.
        origin: String,
        /// Name inside the file.
        name: String,
        /// Place of the value in the tensor, row-major.
        index: usize,
        /// The value as stored.
        value: f64,
    },
}

fn describe(origin: &str, missing: &[String], extra: &[String], misshapen: &[Misshapen]) -> String {
    let size = |m: &Misshapen| format!("{} {:?} instead of {:?}", m.name, m.found, m.expected);
    let sizes: Vec<String> = misshapen.iter().map(size).collect();
    let kinds = [("missing", missing), ("not known", extra), ("of another size", &sizes)];
    let told = kinds.into_iter().filter(|(_, all)| !all.is_empty()).map(|(kind, all)| {
        let (first, rest) = all.split_at(all.len().min(NAMED));
        let more = if rest.is_empty() { "" } else { ", ..." };
        format!("{} {kind} ({}{more})", all.len(), first.join(", "))
    });
    format!("{origin} does not fit the network, tensors: {}", told.collect::<Vec<_>>().join(", "))
}

/// One tensor of a safetensors file, widened to f64.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredTensor {
    /// Name inside the file, as written.
    pub name: String,
    /// Dimensions, rank kept.
    pub dims: Vec<usize>,
    /// Values, row-major.
    pub values: Vec<f64>,
}

/// Reads all f32 and f64 tensors of a file; batch counters are skipped.
///
/// # Errors
/// [`WeightError::Read`], [`WeightError::Format`] or [`WeightError::ElementType`].
pub fn read(path: &Path) -> Result<Vec<StoredTensor>, WeightError> {
    let bytes = fs::read(path).map_err(|source| WeightError::Read { path: path.to_owned(), source })?;
    parse(&bytes, &path.display().to_string())
}

/// Reads all f32 and f64 tensors from memory; `origin` is used in error messages.
///
/// # Errors
/// [`WeightError::Format`] or [`WeightError::ElementType`].
pub fn parse(bytes: &[u8], origin: &str) -> Result<Vec<StoredTensor>, WeightError> {
    let file = SafeTensors::deserialize(bytes).map_err(|source| WeightError::Format { origin: origin.to_owned(), source })?;
    let mut tensors = file.tensors();
    tensors.retain(|(name, _)| !name.ends_with(COUNTER));
    tensors.sort_by(|a, b| a.0.cmp(&b.0));
    tensors.into_iter().map(|(name, view)| decode(name, &view, origin)).collect()
}

fn decode(name: String, view: &TensorView, origin: &str) -> Result<StoredTensor, WeightError> {
    let values = match view.dtype() {
        Dtype::F32 => words::<4>(view.data()).map(|b| f64::from(f32::from_le_bytes(b))).collect(),
        Dtype::F64 => words::<8>(view.data()).map(f64::from_le_bytes).collect(),
        other => {
            return Err(WeightError::ElementType { origin: origin.to_owned(), name, dtype: format!("{other:?}") });
        }
    };
    Ok(StoredTensor { name, dims: view.shape().to_vec(), values })
}

fn words<const N: usize>(bytes: &[u8]) -> impl Iterator<Item = [u8; N]> {
    bytes.as_chunks::<N>().0.iter().copied()
}

/// Replaces every value of `params` by those of `tensors`; nothing changes on an error.
/// A `module.` prefix is stripped, and the second name of a tensor that the reference registers twice stands for its first.
///
/// # Errors
/// [`WeightError::Mismatch`] with all differences, unless names and dimensions are equal; [`WeightError::NonFinite`] for the first
/// value that is not finite in the precision of `T`.
pub fn assign<T: Scalar>(params: &mut Params<T>, tensors: Vec<StoredTensor>, origin: &str) -> Result<(), WeightError> {
    let mut given: BTreeMap<String, StoredTensor> = BTreeMap::new();
    for tensor in tensors {
        let name = tensor.name.strip_prefix(WRAPPER).unwrap_or(&tensor.name);
        given.insert(name.to_owned(), tensor);
    }
    names::resolve_aliases(params, &mut given);
    let (mut missing, mut misshapen) = (Vec::new(), Vec::new());
    for (name, entry) in params.iter() {
        match given.get(name) {
            None => missing.push(name.to_owned()),
            Some(t) if t.dims != entry.dims() => {
                misshapen.push(Misshapen { name: name.to_owned(), expected: entry.dims().to_vec(), found: t.dims.clone() })
            }
            Some(_) => {}
        }
    }
    let known = |name: &&String| params.get(name).is_none();
    let extra: Vec<String> = given.keys().filter(known).cloned().collect();
    if !(missing.is_empty() && extra.is_empty() && misshapen.is_empty()) {
        let origin = origin.to_owned();
        return Err(WeightError::Mismatch { origin, missing, extra, misshapen });
    }
    for (name, stored) in &given {
        if let Some(index) = stored.values.iter().position(|&value| !T::from_f64(value).to_f64().is_finite()) {
            let (origin, name) = (origin.to_owned(), name.clone());
            return Err(WeightError::NonFinite { origin, name, index, value: stored.values[index] });
        }
    }
    for (name, entry) in params.iter_mut() {
        if let Some(stored) = given.remove(name) {
            let values = stored.values.into_iter().map(T::from_f64).collect();
            entry.set(Tensor::from_vec(shape_of(&stored.dims), values));
        }
    }
    Ok(())
}

/// The safetensors bytes of `params`, in the precision of `T`.
///
/// # Errors
/// [`WeightError::Format`] when the library refuses a tensor.
pub fn to_bytes<T: Scalar>(params: &Params<T>) -> Result<Vec<u8>, WeightError> {
    let double = T::NAME == "f64";
    let dtype = if double { Dtype::F64 } else { Dtype::F32 };
    let encode = |v: &T| {
        let v = v.to_f64();
        if double { v.to_le_bytes().to_vec() } else { (v as f32).to_le_bytes().to_vec() }
    };
    let buffers: Vec<Vec<u8>> = params.iter().map(|(_, e)| e.tensor().data().iter().flat_map(encode).collect()).collect();
    let format = |source| WeightError::Format { origin: "the set of parameters".to_owned(), source };
    let views =
        params.iter().zip(&buffers).map(|((name, e), bytes)| Ok((name, TensorView::new(dtype, e.dims().to_vec(), bytes)?)));
    let views = views.collect::<Result<Vec<_>, _>>().map_err(format)?;
    safetensors::serialize(views, None).map_err(format)
}

/// Saves the tensors of one checkpoint file, whole or not at all.
///
/// # Errors
/// [`WeightError::Write`] or [`WeightError::Format`].
pub fn save<T: Scalar>(path: &Path, params: &Params<T>) -> Result<(), WeightError> {
    replace_file(path, &to_bytes(params)?).map_err(|source| WeightError::Write { path: path.to_owned(), source })
}

/// Loads one checkpoint file into `params`, whose names and dimensions it must have.
///
/// # Errors
/// Any [`WeightError`] but `Write`; `params` is unchanged then.
pub fn load<T: Scalar>(path: &Path, params: &mut Params<T>) -> Result<(), WeightError> {
    assign(params, read(path)?, &path.display().to_string())
}

/// Saves every file of a network as `<directory>/<file>.safetensors`.
///
/// # Errors
/// As [`save`]; also when the directory cannot be made.
pub fn save_directory<T: Scalar>(directory: &Path, set: &ParamSet<T>) -> Result<(), WeightError> {
    fs::create_dir_all(directory).map_err(|source| WeightError::Write { path: directory.to_owned(), source })?;
    set.files().try_for_each(|(file, params)| save(&file_path(directory, file), params))
}

/// Loads every file of a network from `<directory>/<file>.safetensors`. All files are read and
/// checked before the first value changes.
///
/// # Errors
/// As [`load`]; `set` is unchanged then.
pub fn load_directory<T: Scalar>(directory: &Path, set: &mut ParamSet<T>) -> Result<(), WeightError> {
    let mut loaded = set.clone();
    let files: Vec<String> = set.files().map(|(file, _)| file.to_owned()).collect();
    for file in files {
        load(&file_path(directory, &file), loaded.file_mut(&file))?;
    }
    *set = loaded;
    Ok(())
}

fn file_path(directory: &Path, file: &str) -> PathBuf {
    directory.join(format!("{file}.safetensors"))
}

mod names;

#[cfg(test)]
mod tests;
