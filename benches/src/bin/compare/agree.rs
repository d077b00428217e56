//! Whether both sides compute the same: a benchmark of different work is worth nothing.

use std::path::Path;

use dimode_benches::Results;
use dimode_benches::inputs::read;
use serde_json::Value;

/// What a comparison of numbers found.
#[derive(Debug, Default)]
pub struct Agreement {
    /// Largest difference as a share of what is accepted; infinite when a number is missing.
    pub difference: f64,
    /// What differs by more than is accepted, or is missing.
    pub refused: Vec<String>,
}

impl Agreement {
    fn add(&mut self, name: &str, difference: f64, accepted: f64) {
        if difference > accepted {
            self.refused.push(format!("{name}: {difference:.1e} > {accepted:.0e}"));
        }
        self.difference = self.difference.max(difference / accepted);
    }

    fn miss(&mut self, what: String) {
        self.refused.push(what);
        self.difference = f64::INFINITY;
    }
}

/// Compares our results with the files and values of a peer.
pub fn agree(ours: &Results, folder: &Path, values: &Value) -> Agreement {
    let mut found = Agreement::default();
    for (name, tensor, accepted) in &ours.tensors {
        match read(&folder.join(format!("{name}.bin")), tensor.shape().len()) {
            Ok(theirs) => found.add(name, relative_distance(tensor.data(), &theirs), *accepted),
            Err(error) => found.miss(format!("{error:#}")),
        }
    }
    for (name, value, accepted) in &ours.values {
        match values[name].as_f64() {
            Some(theirs) => found.add(name, relative_distance(&[*value as f32], &[theirs as f32]), *accepted),
            None => found.miss(format!("the peer gave no {name}")),
        }
    }
    found
}

/// `|a - b| / |b|`; infinite when a number is not finite.
fn relative_distance(a: &[f32], b: &[f32]) -> f64 {
    let norm = |numbers: &mut dyn Iterator<Item = f64>| numbers.map(|x| x * x).sum::<f64>().sqrt();
    let distance = norm(&mut a.iter().zip(b).map(|(a, b)| f64::from(*a) - f64::from(*b)));
    let size = norm(&mut b.iter().map(|b| f64::from(*b)));
    let relative = distance / size.max(f64::MIN_POSITIVE);
    if relative.is_nan() { f64::INFINITY } else { relative }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_value_that_differs_or_is_missing_is_refused() {
        let values = vec![("near".into(), 1.0, 1e-3), ("far".into(), 1.0, 1e-3), ("absent".into(), 1.0, 1e-3)];
        let ours = Results { tensors: Vec::new(), values };
        let found = agree(&ours, Path::new("nowhere"), &json!({"near": 1.0001, "far": 2.0}));
        assert_eq!((found.refused.len(), found.difference), (2, f64::INFINITY), "{:?}", found.refused);
        assert!(found.refused[0].starts_with("far"));
    }
}
