//! From files of any form to the safetensors files of a network.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::Result;
use dimode_nets::weights::{self, Differences, ElementType, StoredTensor, WeightFile, dialects};
use dimode_nets::{Blueprint, NetKind, ParamSet, Params, WeightError};

use super::{ConvertError, FileMisfit};
use crate::counted::counted;
use crate::data::staging::{Earlier, Staging};

/// A file to convert, and which file of the network it is, if that is said.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Input {
    /// File of the network, such as `encoder`.
    pub file: Option<String>,
    /// Where it is.
    pub path: PathBuf,
}

impl FromStr for Input {
    type Err = Infallible;

    /// `PATH`, or `FILE=PATH`.
    fn from_str(text: &str) -> Result<Self, Infallible> {
        // An equals sign in a folder's name belongs to the path.
        Ok(match text.split_once('=') {
            Some((file, path)) if !file.is_empty() && !file.contains(std::path::is_separator) => {
                Self { file: Some(file.to_owned()), path: path.into() }
            }
            _ => Self { file: None, path: text.into() },
        })
    }
}

/// What to convert and how.
#[derive(Clone, Debug, PartialEq)]
pub struct ConvertRequest {
    /// The network that the weights are for.
    pub network: NetKind,
    /// Files with its weights.
    pub inputs: Vec<Input>,
    /// Folder to write.
    pub out: PathBuf,
    /// Take what fits and leave the rest.
    pub partial: bool,
    /// Replace a folder that an earlier conversion wrote.
    pub force: bool,
    /// Seed of the values of tensors that are not given, for a partial conversion.
    pub seed: u64,
}

/// What was written.
#[derive(Clone, Debug, PartialEq)]
pub struct Conversion {
    /// The files, in the order of the network.
    pub files: Vec<ConvertedFile>,
    /// What was recognised, renamed and left out on the way.
    pub notes: Vec<String>,
    /// Files of the network that were not given; nothing is written for them.
    pub absent: Vec<String>,
}

/// One file that was written.
#[derive(Clone, Debug, PartialEq)]
pub struct ConvertedFile {
    /// File of the network.
    pub file: String,
    /// Where the values came from.
    pub from: PathBuf,
    /// Tensors with values from there.
    pub taken: usize,
    /// What did not fit; empty unless the conversion was partial.
    pub skipped: Differences,
}

/// Tensors for one file of the network.
struct Source {
    from: PathBuf,
    tensors: Vec<StoredTensor>,
}

/// Reads all inputs, checks them against the network, writes `<out>/<file>.safetensors` for each file and reads it back. The folder
/// appears whole or not at all.
///
/// **Errors** [`ConvertError`], [`WeightError`], and [`crate::data::DataError`] for the folder.
pub fn convert(request: &ConvertRequest) -> Result<Conversion> {
    let network = request.network.blueprint();
    let entries: Vec<String> = network.files().into_iter().map(file_name).collect();
    let entries: Vec<&str> = entries.iter().map(String::as_str).collect();
    let staging = Staging::new(&request.out, Earlier::Replace { entries: &entries, asked: request.force })?;
    let mut notes = Vec::new();
    let mut sources = sources(request, &network, &mut notes)?;
    let absent = absent(request, &network, &sources)?;
    let all: ParamSet<f32> = network.init(request.seed);
    let (mut set, mut files, mut misfits) = (ParamSet::new(), Vec::new(), Vec::new());
    for (file, params) in all.files() {
        let Some(source) = sources.remove(file) else { continue };
        let mut params = params.clone();
        let (file, Source { from, tensors }) = (file.to_owned(), source);
        match take(&mut params, tensors, &from, request.partial) {
            Ok(skipped) => {
                let taken = params.len() - skipped.missing.len() - skipped.misshapen.len();
                *set.file_mut(&file) = params;
                files.push(ConvertedFile { file, from, taken, skipped });
            }
            Err(WeightError::Mismatch { differences, .. }) => misfits.push(FileMisfit { file, from, differences }),
            Err(other) => return Err(other.into()),
        }
    }
    if !misfits.is_empty() {
        return Err(ConvertError::Misfit { network: request.network, misfits }.into());
    }
    staging.fill(|folder| {
        weights::save_directory(folder, &set)?;
        read_back(folder, &set)
    })?;
    Ok(Conversion { files, notes, absent })
}

fn file_name(file: &str) -> String {
    format!("{file}.safetensors")
}

fn take(params: &mut Params<f32>, tensors: Vec<StoredTensor>, from: &Path, partial: bool) -> Result<Differences, WeightError> {
    let origin = from.display().to_string();
    if partial {
        return weights::assign_partial(params, tensors, &origin);
    }
    weights::assign(params, tensors, &origin).map(|()| Differences::default())
}

/// The tensors for each file of the network.
fn sources(request: &ConvertRequest, network: &Blueprint, notes: &mut Vec<String>) -> Result<BTreeMap<String, Source>> {
    let mut sources: BTreeMap<String, Source> = BTreeMap::new();
    for input in &request.inputs {
        let stored = weights::open(&input.path)?;
        notes.extend(told(&input.path, &stored));
        for (file, tensors) in placed(request, network, input, stored.tensors, notes)? {
            let source = Source { from: input.path.clone(), tensors };
            if let Some(first) = sources.get(&file) {
                return Err(ConvertError::Twice { file, first: first.from.clone(), second: source.from }.into());
            }
            sources.insert(file, source);
        }
    }
    Ok(sources)
}

/// What a file holds beside the tensors, and what becomes of its numbers.
fn told(path: &Path, stored: &WeightFile) -> Vec<String> {
    let path = path.display();
    let mut notes = vec![format!("{path}: {}, {}", stored.form, counted(stored.tensors.len(), "tensor"))];
    let first = &mut notes[0];
    *first += &stored.under.as_ref().map(|key| format!(" under '{key}'")).unwrap_or_default();
    if stored.counters > 0 {
        *first += &format!("; left out: {}", counted(stored.counters, "batch counter"));
    }
    notes.extend(stored.ignored.iter().map(|entry| format!("{path}: left out: {} ({})", entry.name, entry.what)));
    for (element, becomes) in
        [(ElementType::F64, "rounded to F32"), (ElementType::F16, "widened to F32"), (ElementType::BF16, "widened to F32")]
    {
        let count = stored.tensors.iter().filter(|tensor| tensor.element == element).count();
        if count > 0 {
            notes.push(format!("{path}: {} of {element} {becomes}", counted(count, "tensor")));
        }
    }
    notes
}

/// The tensors of one input by file of the network.
fn placed(
    request: &ConvertRequest,
    network: &Blueprint,
    input: &Input,
    tensors: Vec<StoredTensor>,
    notes: &mut Vec<String>,
) -> Result<BTreeMap<String, Vec<StoredTensor>>, ConvertError> {
    let known: Vec<String> = network.files().into_iter().map(str::to_owned).collect();
    if let Some(given) = input.file.as_ref().filter(|file| !known.contains(file)) {
        return Err(ConvertError::UnknownFile { network: request.network, given: given.clone(), known });
    }
    if let Some(dialect) = dialects::recognise(tensors.iter().map(|tensor| tensor.name.as_str()), network) {
        let mut translation = dialect.translate(tensors, network);
        notes.push(format!("{}: {}: {}", input.path.display(), dialect.name, dialect.note));
        notes.extend(translation.left_out.iter().map(|name| format!("{}: left out: {name}", input.path.display())));
        translation.files.retain(|file, _| input.file.as_ref().is_none_or(|given| given == file));
        return Ok(translation.files);
    }
    let file = input.file.clone().or_else(|| by_name(&known, &input.path)).or_else(|| by_tensors(network, &known, &tensors));
    match file {
        Some(file) => Ok(BTreeMap::from([(file, tensors)])),
        None => Err(ConvertError::Unclear { path: input.path.clone(), network: request.network, known }),
    }
}

/// The file of the network that has the name of a path; a network of one file takes any.
fn by_name(known: &[String], path: &Path) -> Option<String> {
    let stem = path.file_stem()?.to_string_lossy();
    known.iter().find(|file| known.len() == 1 || **file == stem).cloned()
}

/// The one file of the network that has any of these tensors.
fn by_tensors(network: &Blueprint, known: &[String], tensors: &[StoredTensor]) -> Option<String> {
    let names: Vec<&str> = tensors.iter().map(|tensor| weights::plain_name(&tensor.name)).collect();
    let mut sharing = known.iter().filter(|file| network.file(file).any(|(name, _)| names.contains(&name)));
    sharing.next().filter(|_| sharing.next().is_none()).cloned()
}

/// Files of the network that nothing is given for; an error unless the conversion is partial.
fn absent(
    request: &ConvertRequest,
    network: &Blueprint,
    sources: &BTreeMap<String, Source>,
) -> Result<Vec<String>, ConvertError> {
    let without = network.files().into_iter().filter(|file| !sources.contains_key(*file));
    let missing: Vec<String> = without.map(str::to_owned).collect();
    if missing.is_empty() || request.partial {
        return Ok(missing);
    }
    Err(ConvertError::NotAll { network: request.network, missing })
}

/// Compares what is on the disk with what was meant, bit for bit.
fn read_back(folder: &Path, set: &ParamSet<f32>) -> Result<()> {
    for (file, params) in set.files() {
        let path = folder.join(file_name(file));
        let stored = weights::read(&path)?;
        let same = |tensor: &StoredTensor| {
            params.get(&tensor.name).is_some_and(|entry| {
                let bits = entry.tensor().data().iter().map(|&value| f64::from(value).to_bits());
                entry.dims() == tensor.dims && bits.eq(tensor.values.iter().map(|value| value.to_bits()))
            })
        };
        if stored.len() != params.len() || !stored.iter().all(same) {
            return Err(ConvertError::ReadBack { path }.into());
        }
    }
    Ok(())
}

impl Conversion {
    /// What was read, taken, skipped and written, one on a line.
    pub fn render(&self, request: &ConvertRequest) -> String {
        let mut text: String = self.notes.iter().map(|note| format!("{note}\n")).collect();
        for file in &self.files {
            let all = file.taken + file.skipped.missing.len() + file.skipped.misshapen.len();
            for line in file.skipped.list().lines() {
                text += &format!("{} skipped, {line}\n", file.file);
            }
            let path = request.out.join(file_name(&file.file));
            text += &format!("{}: {} of {} from {}\n", path.display(), file.taken, counted(all, "tensor"), file.from.display());
        }
        let absent = self.absent.iter().map(|file| format!("not written: {file}, for which no file was given\n"));
        text += &absent.collect::<String>();
        if self.files.iter().any(|file| !file.skipped.missing.is_empty() || !file.skipped.misshapen.is_empty()) {
            text += &format!("missing tensors and those of another size have start values of seed {}\n", request.seed);
        }
        text
    }
}
