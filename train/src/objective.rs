//! The total loss `L = L_pho + smoothness + scale + lambda1 (L_axi + L_pla) + lambda2 (L_rad + L_tan) + lambda3 L_loc` of a batch, term by term
//! (paper, eq. `overall_loss`).
//!
//! The terms are measured on a tape of their own whose leaves are what the networks said: disparities, rotations,
//! translations. That is where each term's gradient with respect to depth, rotation and translation is read off.

use std::sync::Arc;

use dimode_autodiff::ops::bilinear_sample::SamplePadding;
use dimode_autodiff::{Gradients, Pool, Tape, Tensor, Var, rng};
use dimode_geometry::Intrinsics;
use dimode_geometry::losses as geometric;
use dimode_geometry::taped::{self, Pose, masks};

use crate::batch::{Batch, join};
use crate::config::{Config, LossConfig, SCALE_ANCHOR, Sources, StageConfig};
use crate::losses::flow_consistency::flow_consistency;
use crate::losses::local_structure::local_structure;
use crate::losses::min_reprojection::min_reprojection;
use crate::losses::photometric::{photometric, photometric_value};
use crate::losses::scale_anchor::scale_anchor;
use crate::losses::smoothness::smoothness;
use crate::model::DepthRange;
use crate::non_finite::Failure;

/// What the networks said about a batch of `n` snippets.
pub struct Outputs<'t> {
    /// Disparities of the targets in (0, 1), full size first, `[n, 1, h, w]`.
    pub disparities: Vec<Var<'t, f32>>,
    /// Disparities of the sources, previous ones first, `[2 n, 1, h, w]`; only when the alignment needs them.
    pub source_disparity: Option<Var<'t, f32>>,
    /// Motions `source_from_target`, 2 n of them, previous ones first.
    pub motion: Pose<'t, f32>,
}

/// The gradient of the total with respect to [`Outputs`], in the same order.
pub struct OutputGradients(Vec<Tensor<f32>>);

impl<'t> Outputs<'t> {
    fn all(&self) -> Vec<Var<'t, f32>> {
        let mut all = self.disparities.clone();
        all.extend(self.source_disparity);
        all.extend([self.motion.rotation, self.motion.translation]);
        all
    }

    /// A scalar whose gradient with respect to the outputs is the given one.
    pub fn carry(&self, gradients: &OutputGradients) -> Var<'t, f32> {
        let parts: Vec<_> = self.all().into_iter().zip(&gradients.0).map(|(x, g)| dot(x, g)).collect();
        parts.into_iter().reduce(|a, b| a.add(b)).expect("there are always outputs")
    }

    /// The same values as leaves of another tape.
    fn on<'l>(&self, tape: &'l Tape<f32>) -> Outputs<'l> {
        Outputs {
            disparities: self.disparities.iter().map(|d| tape.leaf(d.value())).collect(),
            source_disparity: self.source_disparity.map(|d| tape.leaf(d.value())),
            motion: Pose {
                rotation: tape.leaf(self.motion.rotation.value()),
                translation: tape.leaf(self.motion.translation.value()),
            },
        }
    }
}

/// Norms of a weighted term's gradient with respect to disparities and motions `source_from_target`.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct TermGradients {
    /// Disparities.
    pub disparity: f64,
    /// Rotations, per radian of a small turn about each axis.
    pub rotation: f64,
    /// Tangential translation (x, y).
    pub tangential: f64,
    /// Radial translation (z).
    pub radial: f64,
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
}

/// Terms, total and gradients.
pub struct Losses {
    /// The terms in order.
    pub terms: Vec<TermReport>,
    /// Weighted sum.
    pub total: f64,
    /// Gradient with respect to the outputs.
    pub gradients: OutputGradients,
}

struct Term<'l> {
    name: &'static str,
    weight: f64,
    value: Var<'l, f32>,
    valid: f64,
}

/// Whether a stage needs the optical flow.
pub fn needs_flow(loss: &LossConfig, stage: &StageConfig) -> bool {
    needs_source_depth(stage) || loss.flow_consistency > 0.0
}

/// Whether a stage needs the depth of the sources.
pub fn needs_source_depth(stage: &StageConfig) -> bool {
    stage.lambda1 > 0.0 || stage.lambda2 > 0.0
}

/// What a step brings along beside the networks' outputs.
#[derive(Clone, Copy)]
pub struct Given<'a> {
    /// The frames.
    pub batch: &'a Batch,
    /// The weights.
    pub stage: &'a StageConfig,
    /// Optical flow from the target to both sources, `[2 n, 2, h, w]`, previous first.
    pub flow: Option<&'a Tensor<f32>>,
    /// Number of the step, from 0.
    pub step: u64,
    /// Whether each term's gradient is measured apart.
    pub probe: bool,
}

/// Measures every term of the stage and the gradient of their weighted sum.
///
/// # Errors
/// When a term or its gradient is not finite.
pub fn measure(
    config: &Config,
    range: DepthRange,
    pool: &Arc<Pool<f32>>,
    outputs: &Outputs<'_>,
    given: &Given<'_>,
) -> Result<Losses, Failure> {
    let Given { batch, stage, flow, step, probe } = *given;
    let tape = Tape::with_pool(pool.clone());
    let leaves = outputs.on(&tape);
    let scene = Scene::new(config, range, batch, &leaves, step);
    let mut terms = Vec::new();
    scene.photometric(&mut terms);
    scene.smoothness(&mut terms);
    scene.scale_anchor(&mut terms);
    scene.local_structure(stage, &mut terms);
    if let Some(flow) = flow {
        scene.geometric(stage, flow, &mut terms);
    }
    collect(&tape, &leaves, terms, probe, batch.names.len())
}

/// What the terms share: both sources stacked along the samples, previous first.
struct Scene<'a, 'l> {
    config: &'a Config,
    batch: &'a Batch,
    range: DepthRange,
    leaves: &'a Outputs<'l>,
    step: u64,
    /// Cameras of the stacked samples.
    cameras: Vec<Intrinsics>,
    /// Rotation `source_from_target`, `[2 n, 1, 3, 3]`.
    rotation: Var<'l, f32>,
    /// Translation `source_from_target`, `[2 n, 3, 1, 1]`.
    translation: Var<'l, f32>,
    /// Depth of the target at full size, once for each source, `[2 n, 1, h, w]`.
    depth: Var<'l, f32>,
    /// Flow and source depth by depth and motion, `[2 n, 3, h, w]`.
    rigid: Var<'l, f32>,
}

impl<'a, 'l> Scene<'a, 'l> {
    fn new(config: &'a Config, range: DepthRange, batch: &'a Batch, leaves: &'a Outputs<'l>, step: u64) -> Self {
        let Pose { rotation, translation } = leaves.motion;
        let cameras = [&batch.intrinsics[..], &batch.intrinsics[..]].concat();
        let depth = twice(range.depth(leaves.disparities[0]));
        let rigid = taped::rigid_flow(depth, rotation, translation, &cameras);
        Scene { config, batch, range, leaves, step, cameras, rotation, translation, depth, rigid }
    }

    /// `l_pho`: minimum over the sources with auto-mask, mean over scales.
    fn photometric(&self, terms: &mut Vec<Term<'l>>) {
        let images = &self.batch.plain;
        let (n, tape) = (self.batch.names.len(), self.depth.tape());
        let sources = join(&[&images.previous, &images.next]);
        let target = join(&[&images.target, &images.target]);
        let identities = if self.config.loss.auto_mask { self.identities(&sources, &target) } else { Vec::new() };
        let (sources, target) = (tape.constant(sources), tape.constant(target));
        let mut total = None;
        let mut valid = 0.0;
        let scales = self.leaves.disparities.len();
        for (scale, &disparity) in self.leaves.disparities.iter().enumerate() {
            let rigid = if scale == 0 { self.rigid } else { self.rigid_at(disparity) };
            let error = photometric(taped::warp(sources, rigid.slice(1, 0, 2), SamplePadding::Border), target);
            let best = min_reprojection(&[error.slice(0, 0, n), error.slice(0, n, n)], &identities);
            valid += best.share / scales as f64;
            let mean = best.error.mean().scale(1.0 / scales as f64);
            total = Some(total.map_or(mean, |t: Var<'l, f32>| t.add(mean)));
        }
        let value = total.expect("at least one scale");
        terms.push(Term { name: "l_pho", weight: 1.0, value, valid });
    }

    /// Errors of the unwarped sources with a little noise that breaks ties, one map for each source.
    fn identities(&self, sources: &Tensor<f32>, target: &Tensor<f32>) -> Vec<Tensor<f32>> {
        let error = photometric_value(sources, target);
        let noise = rng::uniform::<f32>(self.config.seed ^ (self.step << 20), error.shape(), 0.0, 2e-5);
        let half = error.shape().len() / 2;
        let mut shape = error.shape();
        shape.0[0] /= 2;
        [0, half]
            .map(|at| {
                let pairs = error.data()[at..at + half].iter().zip(&noise.data()[at..at + half]);
                Tensor::from_vec(shape, pairs.map(|(e, n)| e + n).collect())
            })
            .to_vec()
    }

    /// Rigid flow by a coarser disparity, resized to the full size.
    fn rigid_at(&self, disparity: Var<'l, f32>) -> Var<'l, f32> {
        let s = self.depth.shape();
        let depth = twice(self.range.depth(disparity.resize_bilinear(s.h(), s.w(), false)));
        taped::rigid_flow(depth, self.rotation, self.translation, &self.cameras)
    }

    /// `smooth`: edge-aware smoothness, halved at each coarser scale, mean over scales.
    fn smoothness(&self, terms: &mut Vec<Term<'l>>) {
        let weight = self.config.loss.smoothness;
        if weight == 0.0 {
            return;
        }
        let scales = self.leaves.disparities.len();
        let tape = self.depth.tape();
        let parts = self.leaves.disparities.iter().enumerate().map(|(scale, &disparity)| {
            let s = disparity.shape();
            let image = tape.constant(self.batch.plain.target.clone()).resize_bilinear(s.h(), s.w(), false).value();
            smoothness(disparity, &image).scale(1.0 / (scales << scale) as f64)
        });
        let value = parts.reduce(|a, b| a.add(b)).expect("at least one scale");
        terms.push(Term { name: "smooth", weight, value, valid: 1.0 });
    }

    /// `scale`: the mean disparity stays where the sigmoid has slope.
    fn scale_anchor(&self, terms: &mut Vec<Term<'l>>) {
        let weight = self.config.loss.scale_anchor;
        if weight > 0.0 {
            let value = scale_anchor(self.leaves.disparities[0], SCALE_ANCHOR);
            terms.push(Term { name: "scale", weight, value, valid: 1.0 });
        }
    }

    /// `l_loc`: local structure against a pseudo-depth.
    fn local_structure(&self, stage: &StageConfig, terms: &mut Vec<Term<'l>>) {
        if stage.lambda3 == 0.0 {
            return;
        }
        let depth = self.range.depth(self.leaves.disparities[0]);
        let image = &self.batch.plain.target;
        if let Some(value) = local_structure(&self.config.loss.local_structure, depth, image, &self.batch.intrinsics) {
            terms.push(Term { name: "l_loc", weight: stage.lambda3, value, valid: 1.0 });
        }
    }

    /// The four geometric losses, and flow consistency when asked for.
    fn geometric(&self, stage: &StageConfig, flow: &Tensor<f32>, terms: &mut Vec<Term<'l>>) {
        let tape = self.depth.tape();
        let visible = masks::in_view(flow);
        let rigid = self.rigid.slice(1, 0, 2);
        let consistency = self.config.loss.flow_consistency;
        if consistency > 0.0 {
            let mask = masks::static_pixels(&rigid.value(), flow, Some(&visible));
            let value = flow_consistency(rigid, flow, &mask);
            terms.push(Term { name: "flow_consistency", weight: consistency, value, valid: share(&mask) });
        }
        if !needs_source_depth(stage) {
            return;
        }
        let options = &self.config.loss.geometric;
        let source = self.leaves.source_disparity.expect("sources were run for this stage");
        let mask = self.chosen_sources(options.static_mask.among(visible, &rigid.value(), flow));
        let inputs = geometric::PairInputs {
            target_depth: self.depth,
            source_depth: self.range.depth(source),
            flow: tape.constant(flow.clone()),
            rotation: self.rotation,
            translation: self.translation,
            intrinsics: &self.cameras,
            mask: &mask,
        };
        let pair = geometric::AlignedPair::new(&inputs, options);
        type Loss<'l> = fn(&geometric::AlignedPair<'l, f32>, &geometric::LossOptions) -> geometric::LossTerm<'l, f32>;
        let losses: [(_, _, Loss<'l>); 4] = [
            ("l_pla", stage.lambda1, geometric::planar),
            ("l_axi", stage.lambda1, geometric::axial),
            ("l_tan", stage.lambda2, geometric::tangential),
            ("l_rad", stage.lambda2, geometric::radial),
        ];
        for (name, weight, loss) in losses {
            if weight > 0.0 {
                let measured = loss(&pair, options);
                let pixels = measured.counts.iter().sum::<usize>() as f64;
                let valid = pixels / mask.shape().len() as f64;
                terms.push(Term { name, weight, value: measured.mean, valid });
            }
        }
    }

    /// Leaves out the previous frames where only the next ones are wanted.
    fn chosen_sources(&self, mask: Tensor<f32>) -> Tensor<f32> {
        if self.config.loss.sources == Sources::Both {
            return mask;
        }
        let half = mask.shape().len() / 2;
        let data = mask.data().iter().enumerate().map(|(i, &m)| if i < half { 0.0 } else { m }).collect();
        Tensor::from_vec(mask.shape(), data)
    }
}

/// The same samples twice, one copy for each source.
fn twice<'l>(x: Var<'l, f32>) -> Var<'l, f32> {
    Var::concat(&[x, x], 0)
}

/// Share of ones.
fn share(mask: &Tensor<f32>) -> f64 {
    mask.data().iter().map(|&m| f64::from(m)).sum::<f64>() / mask.shape().len() as f64
}

/// Sum of `x * weights`: carries a known gradient into a variable's tape.
fn dot<'t>(x: Var<'t, f32>, weights: &Tensor<f32>) -> Var<'t, f32> {
    x.mul(x.tape().constant(weights.clone())).sum()
}

fn collect<'l>(
    tape: &'l Tape<f32>,
    leaves: &Outputs<'l>,
    terms: Vec<Term<'l>>,
    probe: bool,
    samples: usize,
) -> Result<Losses, Failure> {
    let mut reports = Vec::with_capacity(terms.len());
    let mut total = 0.0;
    for term in &terms {
        let value = f64::from(term.value.value().item());
        if !value.is_finite() {
            let sample = first_bad(leaves.all().iter().map(|x| x.value()), samples);
            return Err(Failure { what: "value", term: term.name.into(), sample });
        }
        total += term.weight * value;
        let gradients = probe.then(|| probe_term(tape, leaves, term));
        reports.push(TermReport { name: term.name.into(), weight: term.weight, value, valid: term.valid, gradients });
    }
    let sum = terms.iter().map(|t| t.value.scale(t.weight)).reduce(|a, b| a.add(b)).expect("l_pho is always there");
    let gradients = tape.backward(sum);
    let of_outputs: Vec<Tensor<f32>> = leaves.all().into_iter().map(|x| gradients.wrt(x)).collect();
    if !of_outputs.iter().all(Tensor::is_finite) {
        return Err(blame(tape, leaves, &terms, samples));
    }
    Ok(Losses { terms: reports, total, gradients: OutputGradients(of_outputs) })
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

fn probe_term<'l>(tape: &'l Tape<f32>, leaves: &Outputs<'l>, term: &Term<'l>) -> TermGradients {
    let gradients: Gradients<f32> = tape.backward(term.value.scale(term.weight));
    let norm = |x: &[f32]| x.iter().map(|&x| f64::from(x) * f64::from(x)).sum::<f64>();
    let disparity: f64 = leaves.disparities.iter().chain(&leaves.source_disparity).map(|&d| norm(gradients.wrt(d).data())).sum();
    let translation = gradients.wrt(leaves.motion.translation);
    let turn = turns(&leaves.motion.rotation.value(), &gradients.wrt(leaves.motion.rotation));
    let axis = |axes: &[usize]| {
        let pairs = (0..translation.shape().n()).flat_map(|n| axes.iter().map(move |&c| (n, c)));
        pairs.map(|(n, c)| f64::from(translation.at(n, c, 0, 0)).powi(2)).sum::<f64>().sqrt()
    };
    TermGradients { disparity: disparity.sqrt(), rotation: norm(&turn).sqrt(), tangential: axis(&[0, 1]), radial: axis(&[2]) }
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
