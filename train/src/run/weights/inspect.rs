//! What a file of weights holds, and which network it fits.

use std::path::{Path, PathBuf};

use anyhow::Result;
use comfy_table::{CellAlignment, Table, presets};
use dimode_nets::weights::{self, Differences, StoredTensor, WeightFile, dialects};
use dimode_nets::{Blueprint, NetKind};
use serde::Serialize;

use crate::counted::counted;

/// How many networks are named that a file nearly fits.
const NEAREST: usize = 3;

/// A file of weights in numbers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Inspection {
    /// The file.
    pub path: PathBuf,
    /// How it stores its tensors.
    pub form: String,
    /// The key under which the dictionary of tensors was found, when it is not the whole file.
    pub under: Option<String>,
    /// Number of values in all tensors.
    pub values: usize,
    /// How many counters of batches were left out.
    pub counters: usize,
    /// Names and contents of entries that are no tensors.
    pub ignored: Vec<(String, String)>,
    /// Files of networks here that have exactly these tensors.
    pub fits: Vec<Fit>,
    /// When there is none: those with the fewest differences.
    pub nearest: Vec<Fit>,
    /// The tensors in the order of the file.
    pub tensors: Vec<TensorSummary>,
}

/// One tensor in numbers; those of no value at all are left out.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TensorSummary {
    /// Name as in the file.
    pub name: String,
    /// The type that the values are stored in.
    pub element: String,
    /// Dimensions.
    pub dims: Vec<usize>,
    /// Mean of the finite values.
    pub mean: Option<f64>,
    /// Standard deviation of the finite values.
    pub std: Option<f64>,
    /// Smallest finite value.
    pub min: Option<f64>,
    /// Largest finite value.
    pub max: Option<f64>,
    /// How many values are infinite or no number.
    pub not_finite: usize,
}

/// A file of a network, beside the tensors of the file that was looked at.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Fit {
    /// Role and name of the network.
    pub network: String,
    /// Which of its files.
    pub file: String,
    /// The form of another program that was recognised.
    pub dialect: Option<&'static str>,
    /// Tensors that the network has in this file.
    pub tensors: usize,
    /// Tensors of the network that are not there.
    pub missing: usize,
    /// Tensors that the network does not have.
    pub extra: usize,
    /// Tensors of other dimensions.
    pub misshapen: usize,
}

/// Reads a file and compares it with every network.
///
/// **Errors** [`dimode_nets::WeightError`].
pub fn inspect(path: &Path) -> Result<Inspection> {
    let file = weights::open(path)?;
    let mut fits: Vec<Fit> = NetKind::all().flat_map(|net| fits_of(&file, net)).collect();
    fits.sort_by_key(Fit::differences);
    let exact = fits.iter().take_while(|fit| fit.differences() == 0).count();
    let mut nearest = fits.split_off(exact);
    nearest.truncate(if exact == 0 { NEAREST } else { 0 });
    // A network that shares nothing with the file is not near.
    nearest.retain(|fit| fit.missing + fit.misshapen < fit.tensors);
    Ok(Inspection {
        path: path.to_owned(),
        form: file.form.to_string(),
        under: file.under,
        values: file.tensors.iter().map(|tensor| tensor.values.len()).sum(),
        counters: file.counters,
        ignored: file.ignored.into_iter().map(|entry| (entry.name, entry.what)).collect(),
        fits,
        nearest,
        tensors: file.tensors.iter().map(summary).collect(),
    })
}

/// The file beside each file of a network; one that another program names differently goes where that form says.
fn fits_of(file: &WeightFile, net: NetKind) -> Vec<Fit> {
    let network = net.blueprint();
    match dialects::recognise(file.tensors.iter().map(|tensor| tensor.name.as_str()), &network) {
        None => network.files().into_iter().map(|name| fit(net, &network, name, None, &file.tensors)).collect(),
        Some(dialect) => {
            let translation = dialect.translate(file.tensors.clone(), &network);
            let files = translation.files.iter();
            files.map(|(name, tensors)| fit(net, &network, name, Some(dialect.name), tensors)).collect()
        }
    }
}

fn fit(net: NetKind, network: &Blueprint, file: &str, dialect: Option<&'static str>, tensors: &[StoredTensor]) -> Fit {
    let given = tensors.iter().map(|tensor| (tensor.name.as_str(), tensor.dims.as_slice()));
    let Differences { missing, extra, misshapen } = weights::differences(network.file(file), given);
    let [missing, extra, misshapen] = [missing.len(), extra.len(), misshapen.len()];
    let (network, tensors) = (net.to_string(), network.file(file).count());
    Fit { network, file: file.to_owned(), dialect, tensors, missing, extra, misshapen }
}

impl Fit {
    /// Number of differences.
    pub fn differences(&self) -> usize {
        self.missing + self.extra + self.misshapen
    }

    fn line(&self) -> String {
        let dialect = self.dialect.map(|name| format!(", from the {name}")).unwrap_or_default();
        let place = format!("{}, file {}{dialect}", self.network, self.file);
        if self.differences() == 0 {
            return place;
        }
        let told = [(self.missing, "missing"), (self.extra, "not known"), (self.misshapen, "of another size")];
        let told = told.into_iter().filter(|(count, _)| *count > 0).map(|(count, kind)| format!("{count} {kind}"));
        format!("{place}: {}", told.collect::<Vec<_>>().join(", "))
    }
}

fn summary(tensor: &StoredTensor) -> TensorSummary {
    let finite = || tensor.values.iter().copied().filter(|value| value.is_finite());
    let count = finite().count();
    let mean = finite().sum::<f64>() / count as f64;
    let variance = finite().map(|value| (value - mean).powi(2)).sum::<f64>() / count as f64;
    // Sums of huge values may overflow; JSON has no infinity.
    let told = |value: f64| Some(value).filter(|value| count > 0 && value.is_finite());
    TensorSummary {
        name: tensor.name.clone(),
        element: tensor.element.to_string(),
        dims: tensor.dims.clone(),
        mean: told(mean),
        std: told(variance.sqrt()),
        min: told(finite().fold(f64::INFINITY, f64::min)),
        max: told(finite().fold(f64::NEG_INFINITY, f64::max)),
        not_finite: tensor.values.len() - count,
    }
}

impl Inspection {
    /// Everything as text.
    pub fn render(&self) -> String {
        let mut text = format!("file      {}\nform      {}", self.path.display(), self.form);
        text += &self.under.as_ref().map(|key| format!(", tensors under '{key}'")).unwrap_or_default();
        text += &format!("\nholds     {}, {}\n", counted(self.tensors.len(), "tensor"), counted(self.values, "value"));
        if self.counters > 0 {
            text += &format!("left out  {} (num_batches_tracked)\n", counted(self.counters, "counter"));
        }
        text += &self.ignored.iter().map(|(name, what)| format!("left out  {name}: {what}\n")).collect::<String>();
        text += &self.fits.iter().map(|fit| format!("fits      {}\n", fit.line())).collect::<String>();
        if self.fits.is_empty() {
            text += "fits      no network here\n";
        }
        text += &self.nearest.iter().map(|fit| format!("nearest   {}\n", fit.line())).collect::<String>();
        format!("{text}\n{}\n", self.table())
    }

    fn table(&self) -> Table {
        let mut table = Table::new();
        table.load_style(presets::UTF8_FULL_CONDENSED);
        table.set_header(["tensor", "type", "dimensions", "mean", "std", "min", "max", ""]);
        for tensor in &self.tensors {
            let number = |value: Option<f64>| value.map_or_else(String::new, |value| format!("{value:.4}"));
            let [mean, std, min, max] = [tensor.mean, tensor.std, tensor.min, tensor.max].map(number);
            let odd = if tensor.not_finite > 0 { format!("{} not finite", tensor.not_finite) } else { String::new() };
            let (name, element, dims) = (tensor.name.clone(), tensor.element.clone(), format!("{:?}", tensor.dims));
            table.add_row([name, element, dims, mean, std, min, max, odd]);
        }
        for column in table.column_iter_mut().skip(3).take(4) {
            column.set_cell_alignment(CellAlignment::Right);
        }
        table
    }
}
