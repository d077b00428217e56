//! Files and folders of weights.

use std::fs;
use std::path::{Path, PathBuf};

use dimode_autodiff::Scalar;

use super::{StoredTensor, WeightError, WeightFile, assign, pth, safetensors};
use crate::{ParamSet, Params, replace_file};

/// Endings of files of weights, in the order in which a folder is searched.
pub const ENDINGS: [&str; 3] = ["safetensors", "pth", "pt"];

/// Reads a file of weights, whichever form it has; its name does not matter.
///
/// # Errors
/// [`WeightError::Read`], [`WeightError::Format`], [`WeightError::Pth`] or [`WeightError::ElementType`].
pub fn open(path: &Path) -> Result<WeightFile, WeightError> {
    let bytes = fs::read(path).map_err(|source| WeightError::Read { path: path.to_owned(), source })?;
    parse_file(&bytes, &path.display().to_string())
}

/// Reads a file of weights from memory; `origin` is used in error messages.
///
/// # Errors
/// As [`open`], but `Read`.
pub fn parse_file(bytes: &[u8], origin: &str) -> Result<WeightFile, WeightError> {
    if pth::is_one(bytes) {
        return pth::parse(bytes).map_err(|source| WeightError::Pth { origin: origin.to_owned(), source });
    }
    safetensors::parse(bytes, origin)
}

/// The tensors of a file of weights; counters of batches are skipped.
///
/// # Errors
/// As [`open`].
pub fn read(path: &Path) -> Result<Vec<StoredTensor>, WeightError> {
    Ok(open(path)?.tensors)
}

/// The tensors of a file of weights in memory; `origin` is used in error messages.
///
/// # Errors
/// As [`parse_file`].
pub fn parse(bytes: &[u8], origin: &str) -> Result<Vec<StoredTensor>, WeightError> {
    Ok(parse_file(bytes, origin)?.tensors)
}

/// The safetensors bytes of `params`, in the precision of `T`.
///
/// # Errors
/// [`WeightError::Format`] when the library refuses a tensor.
pub fn to_bytes<T: Scalar>(params: &Params<T>) -> Result<Vec<u8>, WeightError> {
    safetensors::to_bytes(params)
}

/// Saves the tensors of one checkpoint file as safetensors, whole or not at all.
///
/// # Errors
/// [`WeightError::Write`] or [`WeightError::Format`].
pub fn save<T: Scalar>(path: &Path, params: &Params<T>) -> Result<(), WeightError> {
    replace_file(path, &to_bytes(params)?).map_err(|source| WeightError::Write { path: path.to_owned(), source })
}

/// Loads one checkpoint file of either form into `params`, whose names and dimensions it must have.
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
    set.files().try_for_each(|(file, params)| save(&directory.join(format!("{file}.{}", ENDINGS[0])), params))
}

/// Loads every file of a network from `<directory>/<file>.safetensors`, or else from `.pth` or `.pt`. All files are read and
/// checked before the first value changes.
///
/// # Errors
/// As [`load`]; `set` is unchanged then.
pub fn load_directory<T: Scalar>(directory: &Path, set: &mut ParamSet<T>) -> Result<(), WeightError> {
    let mut loaded = set.clone();
    let files: Vec<String> = set.files().map(|(file, _)| file.to_owned()).collect();
    for file in files {
        load(&file_in(directory, &file), loaded.file_mut(&file))?;
    }
    *set = loaded;
    Ok(())
}

/// The file of a network in a folder; where there is none, the one to tell that it is missing.
fn file_in(directory: &Path, file: &str) -> PathBuf {
    let mut candidates = ENDINGS.iter().map(|ending| directory.join(format!("{file}.{ending}")));
    let found = candidates.clone().find(|path| path.exists());
    found.or_else(|| candidates.next()).unwrap_or_else(|| directory.join(file))
}
