//! Whether both sides compute the same: a benchmark of different work is worth nothing.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use dimode_benches::Results;
use dimode_benches::inputs::read;
use serde_json::Value;

/// Compares our results with the files and values of a peer; the largest difference as a share of what is accepted.
///
/// # Errors
/// When a number is missing, or differs by more than is accepted.
pub fn agree(ours: &Results, folder: &Path, values: &Value) -> Result<f64> {
    let mut differences = Vec::new();
    for (name, tensor, accepted) in &ours.tensors {
        let theirs = read(&folder.join(format!("{name}.bin")), tensor.shape().len())?;
        differences.push((name, relative_distance(tensor.data(), &theirs), *accepted));
    }
    for (name, value, accepted) in &ours.values {
        let theirs = values[name].as_f64().with_context(|| format!("the peer gave no {name}"))?;
        differences.push((name, relative_distance(&[*value as f32], &[theirs as f32]), *accepted));
    }
    let refused = differences.iter().filter(|(_, difference, accepted)| difference > accepted);
    let refused: Vec<_> =
        refused.map(|(name, difference, accepted)| format!("{name}: {difference:.1e} > {accepted:.0e}")).collect();
    ensure!(refused.is_empty(), "numbers differ by more than is accepted of their norm: {}", refused.join(", "));
    Ok(differences.iter().map(|(_, difference, accepted)| difference / accepted).fold(0.0, f64::max))
}

/// `|a - b| / |b|`; infinite when a number is not finite.
fn relative_distance(a: &[f32], b: &[f32]) -> f64 {
    let norm = |numbers: &mut dyn Iterator<Item = f64>| numbers.map(|x| x * x).sum::<f64>().sqrt();
    let distance = norm(&mut a.iter().zip(b).map(|(a, b)| f64::from(*a) - f64::from(*b)));
    let size = norm(&mut b.iter().map(|b| f64::from(*b)));
    let relative = distance / size.max(f64::MIN_POSITIVE);
    if relative.is_nan() { f64::INFINITY } else { relative }
}
