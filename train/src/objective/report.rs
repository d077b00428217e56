//! What a batch's loss says: total, terms, and which of them pulls where.

use dimode_autodiff::{Gradients, Tape, Tensor};

use super::outputs::{OutputGradients, Outputs};
use super::term::Term;
use crate::model::DepthRange;
use crate::non_finite::Failure;

/// Norms of a weighted term's gradient with respect to disparities and motions `source_from_target`.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct TermGradients {
    /// Disparities, as the network says them.
    pub disparity: f64,
    /// Depths, in one over the unit of depth: the same gradient where far pixels count for what they are.
    pub depth: f64,
    /// Rotations, per radian of a small turn about each axis.
    pub rotation: f64,
    /// Tangential translation (x, y).
    pub tangential: f64,
    /// Radial translation (z).
    pub radial: f64,
}

/// A term on one target and source.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ImageReport {
    /// Value before weighting. Written as `null` when it is not a number, as it may be where too few pixels let the image out of
    /// the mean.
    #[serde(deserialize_with = "number")]
    pub value: f64,
    /// Pixels behind it.
    pub pixels: usize,
}

fn number<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    let number = <Option<f64> as serde::Deserialize>::deserialize(deserializer)?;
    Ok(number.unwrap_or(f64::NAN))
}

/// One term of the loss of one step.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct TermReport {
    /// Name as in the paper: `l_pho`, `l_pla`, ..
    pub name: String,
    /// Weight in the total.
    pub weight: f64,
    /// Value before weighting.
    pub value: f64,
    /// Share of pixels that counted.
    pub valid: f64,
    /// Gradient norms, when they were probed.
    pub gradients: Option<TermGradients>,
    /// Each target with its source, previous sources first; empty for terms that keep no statistics of single images.
    pub images: Vec<ImageReport>,
}

impl TermReport {
    /// A term without gradient norms and single images.
    pub fn new(name: &str, weight: f64, value: f64, valid: f64) -> Self {
        TermReport { name: name.to_owned(), weight, value, valid, gradients: None, images: Vec::new() }
    }
}

/// Terms and total of a batch.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct LossReport {
    /// The terms in order.
    pub terms: Vec<TermReport>,
    /// Weighted sum.
    pub total: f64,
}

/// Sums the terms up and takes their gradient; with the range of depths to `probe` also each term's apart.
pub(super) fn report<'l>(
    tape: &'l Tape<f32>,
    leaves: &Outputs<'l>,
    terms: Vec<Term<'l>>,
    probe: Option<DepthRange>,
    samples: usize,
) -> Result<(LossReport, OutputGradients), Failure> {
    let mut reports = Vec::with_capacity(terms.len());
    let mut total = 0.0;
    for term in &terms {
        let value = f64::from(term.value.value().item());
        if !value.is_finite() {
            let sample = first_bad(leaves.all().iter().map(|x| x.value()), samples);
            return Err(Failure { what: "value", term: term.name.into(), sample });
        }
        total += term.weight * value;
        let gradients = probe.map(|range| probe_term(tape, leaves, term, range));
        let images = term.images.clone();
        reports.push(TermReport { gradients, images, ..TermReport::new(term.name, term.weight, value, term.valid) });
    }
    let sum = terms.iter().map(|t| t.value.scale(t.weight)).reduce(|a, b| a.add(b)).expect("l_pho is always there");
    let gradients = tape.backward(sum);
    let of_outputs: Vec<Tensor<f32>> = leaves.all().into_iter().map(|x| gradients.wrt(x)).collect();
    if !of_outputs.iter().all(Tensor::is_finite) {
        return Err(blame(tape, leaves, &terms, samples));
    }
    Ok((LossReport { terms: reports, total }, OutputGradients(of_outputs)))
}

/// Finds the term whose gradient is not finite.
fn blame<'l>(tape: &'l Tape<f32>, leaves: &Outputs<'l>, terms: &[Term<'l>], samples: usize) -> Failure {
    for term in terms {
        let gradients = tape.backward(term.value);
        let of_outputs: Vec<_> = leaves.all().into_iter().map(|x| gradients.wrt(x)).collect();
        if !of_outputs.iter().all(Tensor::is_finite) {
            let sample = first_bad(of_outputs.into_iter(), samples);
            return Failure { what: "gradient", term: term.name.into(), sample };
        }
    }
    Failure { what: "gradient", term: "the weighted sum of all terms".into(), sample: None }
}

/// First sample with a non-finite element; tensors hold one or two rounds of `samples`.
fn first_bad(tensors: impl Iterator<Item = Tensor<f32>>, samples: usize) -> Option<usize> {
    tensors
        .flat_map(|t| {
            let row = t.shape().len() / t.shape().n();
            t.data().chunks(row).position(|r| r.iter().any(|x| !x.is_finite())).map(|i| i % samples)
        })
        .min()
}

fn probe_term<'l>(tape: &'l Tape<f32>, leaves: &Outputs<'l>, term: &Term<'l>, range: DepthRange) -> TermGradients {
    let gradients: Gradients<f32> = tape.backward(term.value.scale(term.weight));
    let norm = |x: &[f32]| x.iter().map(|&x| f64::from(x) * f64::from(x)).sum::<f64>();
    let maps = || leaves.disparities.iter().chain(&leaves.source_disparities).map(|&d| (d, gradients.wrt(d)));
    let disparity: f64 = maps().map(|(_, g)| norm(g.data())).sum();
    let depth: f64 = maps().map(|(d, g)| norm(&with_respect_to_depth(&d.value(), &g, range))).sum();
    let translation = gradients.wrt(leaves.motion.translation);
    let turn = turns(&leaves.motion.rotation.value(), &gradients.wrt(leaves.motion.rotation));
    let axis = |axes: &[usize]| {
        let pairs = (0..translation.shape().n()).flat_map(|n| axes.iter().map(move |&c| (n, c)));
        pairs.map(|(n, c)| f64::from(translation.at(n, c, 0, 0)).powi(2)).sum::<f64>().sqrt()
    };
    TermGradients {
        disparity: disparity.sqrt(),
        depth: depth.sqrt(),
        rotation: norm(&turn).sqrt(),
        tangential: axis(&[0, 1]),
        radial: axis(&[2]),
    }
}

/// The gradient with respect to the depths `z = 1 / (a d + b)` of disparities `d`, from that with respect to `d`: `-g / (a z^2)`.
fn with_respect_to_depth(disparity: &Tensor<f32>, gradient: &Tensor<f32>, range: DepthRange) -> Vec<f32> {
    let a = (1.0 / range.min - 1.0 / range.max) as f32;
    let depth = range.depth_values(disparity);
    depth.data().iter().zip(gradient.data()).map(|(z, g)| -g / (a * z * z)).collect()
}

/// The gradient with respect to rotation vectors `w` in `R exp(w)` at `w = 0`, from that with respect to the matrices
/// `[n, 1, 3, 3]`: three numbers a sample.
fn turns(rotation: &Tensor<f32>, gradient: &Tensor<f32>) -> Vec<f32> {
    let product = |n: usize, i: usize, j: usize| (0..3).map(|k| rotation.at(n, 0, k, i) * gradient.at(n, 0, k, j)).sum::<f32>();
    let axis = |n: usize, i: usize, j: usize| product(n, j, i) - product(n, i, j);
    (0..rotation.shape().n()).flat_map(|n| [axis(n, 1, 2), axis(n, 2, 0), axis(n, 0, 1)]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::Shape;
    use dimode_autodiff::gradcheck::random;
    use dimode_geometry::so3;
    use nalgebra::{Matrix3, Vector3};

    #[test]
    fn slopes_by_depth_are_those_by_disparity_along_the_same_change() {
        let range = DepthRange { min: 0.5, max: 100.0 };
        let disparity = random::<f32>(1, Shape::new(1, 1, 2, 3), 0.1, 0.9);
        let gradient = random::<f32>(2, disparity.shape(), -1.0, 1.0);
        let by_depth = with_respect_to_depth(&disparity, &gradient, range);
        let depth = |d: f64| 1.0 / (1.0 / range.max + (1.0 / range.min - 1.0 / range.max) * d);
        for (k, by_depth) in by_depth.into_iter().enumerate() {
            let d = f64::from(disparity.data()[k]);
            let slope = (depth(d + 1e-6) - depth(d - 1e-6)) / 2e-6;
            let expected = f64::from(gradient.data()[k]) / slope;
            assert!((f64::from(by_depth) - expected).abs() < 1e-5 * expected.abs(), "{by_depth} instead of {expected}");
        }
    }

    #[test]
    fn turns_are_the_slopes_of_small_turns() {
        let weights = random::<f32>(4, Shape::new(2, 1, 3, 3), -1.0, 1.0);
        let rotations = [Vector3::new(0.3, -0.2, 0.5), Vector3::new(-0.1, 0.7, 0.2)].map(|w| so3::exp(&w));
        let value = |n: usize, r: &Matrix3<f64>| -> f64 {
            (0..3).flat_map(|i| (0..3).map(move |j| (i, j))).map(|(i, j)| f64::from(weights.at(n, 0, i, j)) * r[(i, j)]).sum()
        };
        let plain = Tensor::from_fn(Shape::new(2, 1, 3, 3), |n, _, i, j| rotations[n][(i, j)] as f32);
        let got = turns(&plain, &weights);
        for (k, got) in got.into_iter().enumerate() {
            let (n, axis) = (k / 3, k % 3);
            let turned = |h: f64| value(n, &(rotations[n] * so3::exp(&Vector3::from_fn(|i, _| if i == axis { h } else { 0.0 }))));
            let slope = (turned(1e-4) - turned(-1e-4)) / 2e-4;
            assert!((f64::from(got) - slope).abs() < 1e-5, "sample {n}, axis {axis}: {got} instead of {slope}");
        }
    }
}
