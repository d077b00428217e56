//! How far two files or folders of weights are apart.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Result;
use comfy_table::{CellAlignment, Table, presets};
use dimode_nets::weights::{self, ENDINGS, StoredTensor};
use serde::Serialize;

use super::ConvertError;
use crate::counted::counted;
use crate::data::DataError;

/// What to compare and how closely.
#[derive(Clone, Debug, PartialEq)]
pub struct DiffRequest {
    /// A file, or a folder of files.
    pub a: PathBuf,
    /// The same kind of thing.
    pub b: PathBuf,
    /// Largest relative L2 difference of a tensor that still counts as equal.
    pub tolerance: f64,
}

/// Two sets of weights beside each other.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// One file or folder.
    pub a: PathBuf,
    /// The other.
    pub b: PathBuf,
    /// Largest relative L2 difference of a tensor that still counts as equal.
    pub tolerance: f64,
    /// Whether nothing is missing and every tensor is within the tolerance.
    pub equal: bool,
    /// Tensors that both have in the same dimensions.
    pub tensors: Vec<TensorDifference>,
    /// Names that the second alone has.
    pub missing_in_a: Vec<String>,
    /// Names that the first alone has.
    pub missing_in_b: Vec<String>,
    /// Names with both dimensions, where they differ.
    pub misshapen: Vec<(String, Vec<usize>, Vec<usize>)>,
}

/// How far one tensor is from its twin.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TensorDifference {
    /// The name without prefixes of wrappers; in folders with that of the file.
    pub name: String,
    /// Dimensions.
    pub dims: Vec<usize>,
    /// Largest difference of two values; none where one of them is not finite and the other differs.
    pub largest: Option<f64>,
    /// L2 norm of the difference over the larger L2 norm of the two; none as above.
    pub relative: Option<f64>,
    /// Whether it is within the tolerance.
    pub within: bool,
}

/// Compares two files or two folders of weights, of any form. Prefixes of wrappers do not matter, nor does the type that numbers
/// are stored in.
///
/// **Errors** [`dimode_nets::WeightError`]; [`DataError`] for folders that cannot be read or hold no weights; [`ConvertError`] when
/// a folder is to be compared with a file.
pub fn diff(request: &DiffRequest) -> Result<Comparison> {
    let DiffRequest { a, b, tolerance } = request.clone();
    if a.exists() && b.exists() && a.is_dir() != b.is_dir() {
        return Err(ConvertError::FileAndFolder { a, b }.into());
    }
    let (mut first, mut second) = (tensors(&a)?, tensors(&b)?);
    let known: BTreeSet<String> = second.keys().cloned().collect();
    weights::resolve_aliases(|name| known.contains(name), &mut first);
    let known: BTreeSet<String> = first.keys().cloned().collect();
    weights::resolve_aliases(|name| known.contains(name), &mut second);

    let mut found = Comparison {
        missing_in_a: second.keys().filter(|name| !first.contains_key(*name)).cloned().collect(),
        missing_in_b: first.keys().filter(|name| !second.contains_key(*name)).cloned().collect(),
        ..Comparison {
            a,
            b,
            tolerance,
            equal: false,
            tensors: vec![],
            missing_in_a: vec![],
            missing_in_b: vec![],
            misshapen: vec![],
        }
    };
    for (name, one) in first {
        let Some(other) = second.remove(&name) else { continue };
        match weights::difference(&one, &other) {
            None => found.misshapen.push((name, one.dims, other.dims)),
            Some(apart) => {
                let finite = |value: f64| Some(value).filter(|value| value.is_finite());
                let (largest, relative) = (finite(apart.largest), finite(apart.relative));
                let within = relative.is_some_and(|relative| relative <= tolerance);
                found.tensors.push(TensorDifference { name, dims: one.dims, largest, relative, within });
            }
        }
    }
    let complete = found.missing_in_a.is_empty() && found.missing_in_b.is_empty() && found.misshapen.is_empty();
    found.equal = complete && found.tensors.iter().all(|tensor| tensor.within);
    Ok(found)
}

/// The tensors of a file by name, or of all files of a folder by file and name.
fn tensors(path: &Path) -> Result<BTreeMap<String, StoredTensor>> {
    if !path.is_dir() {
        return Ok(weights::by_plain_name(weights::read(path)?, &path.display().to_string())?);
    }
    let mut all = BTreeMap::new();
    for file in files(path)? {
        let stem = file.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
        let own = weights::by_plain_name(weights::read(&file)?, &file.display().to_string())?;
        for (name, tensor) in own {
            if all.insert(format!("{stem}:{name}"), tensor).is_some() {
                let reason = format!("two files of weights are called {stem}");
                return Err(DataError::malformed(path, &reason, "keep one of them").into());
            }
        }
    }
    Ok(all)
}

/// The files of weights of a folder, by their endings.
fn files(folder: &Path) -> Result<Vec<PathBuf>, DataError> {
    let failed = |source| DataError::Read { path: folder.to_owned(), source };
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        let ending = path.extension().map(|ending| ending.to_string_lossy().into_owned()).unwrap_or_default();
        if ENDINGS.contains(&ending.as_str()) {
            files.push(path);
        }
    }
    if files.is_empty() {
        let advice = format!("name a folder with files that end with {}", ENDINGS.map(|ending| format!(".{ending}")).join(", "));
        return Err(DataError::Missing { path: folder.to_owned(), what: "weights".to_owned(), advice });
    }
    files.sort();
    Ok(files)
}

impl Comparison {
    /// What differs, and a last line that says how much does not.
    pub fn render(&self) -> String {
        let missing = |names: &[String], path: &Path| -> String {
            names.iter().map(|name| format!("missing in {}: {name}\n", path.display())).collect()
        };
        let mut text = missing(&self.missing_in_a, &self.a) + &missing(&self.missing_in_b, &self.b);
        for (name, a, b) in &self.misshapen {
            text += &format!("of another size: {name} {a:?} and {b:?}\n");
        }
        let apart: Vec<&TensorDifference> = self.tensors.iter().filter(|tensor| !tensor.within).collect();
        if !apart.is_empty() {
            text += &format!("{}\n", table(&apart));
        }
        let within = self.tensors.len() - apart.len();
        let all = self.tensors.len() + self.missing_in_a.len() + self.missing_in_b.len() + self.misshapen.len();
        let how = if self.tolerance == 0.0 { "exactly".to_owned() } else { format!("within {:e}", self.tolerance) };
        text + &format!("{within} of {} equal, {how}; the largest difference is {}\n", counted(all, "tensor"), self.largest())
    }

    fn largest(&self) -> String {
        let largest = self.tensors.iter().map(|tensor| tensor.largest.unwrap_or(f64::INFINITY)).fold(0.0, f64::max);
        let relative = self.tensors.iter().map(|tensor| tensor.relative.unwrap_or(f64::INFINITY)).fold(0.0, f64::max);
        format!("{largest:.3e}, relative {relative:.3e}")
    }
}

fn table(tensors: &[&TensorDifference]) -> Table {
    let mut table = Table::new();
    table.load_style(presets::UTF8_FULL_CONDENSED);
    table.set_header(["tensor", "dimensions", "largest difference", "relative (L2)"]);
    for tensor in tensors {
        let number = |value: Option<f64>| value.map_or_else(|| "not finite".to_owned(), |value| format!("{value:.3e}"));
        table.add_row([tensor.name.clone(), format!("{:?}", tensor.dims), number(tensor.largest), number(tensor.relative)]);
    }
    for column in table.column_iter_mut().skip(2) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    table
}
