//! The loss core, forward and backward: the four geometric losses of one pair in their printed form, the photometric part of two
//! sources with smoothness, and both together.
//!
//! Gradients go to the depth of the target and of one source, and to rotation and translation of both sources.

use std::sync::Arc;
use std::time::Duration;

use anyhow::Result;
use dimode::losses::fused_reprojection::{Combine, Frames, fused_reprojection};
use dimode::losses::min_reprojection::min_reprojection;
use dimode::losses::photometric::photometric;
use dimode::losses::smoothness::smoothness;
use dimode_autodiff::ops::bilinear_sample::SamplePadding;
use dimode_autodiff::{Pool, Shape, Tape, Tensor, Var};
use dimode_geometry::Intrinsics;
use dimode_geometry::losses::{LossOptions, PairInputs};
use dimode_geometry::taped::{Pose, rigid_flow, warp};
use serde_json::{Value, json};

use super::losses::{Way, four};
use crate::camera::camera;
use crate::case::{Case, Ours, Results, timed};
use crate::inputs::Inputs;

/// Names and weights of the terms; the first four are geometric.
const TERMS: [(&str, f64); 6] = [("pla", 0.05), ("axi", 0.05), ("tan", 0.1), ("rad", 0.1), ("photo", 1.0), ("smooth", 1e-3)];
/// Largest relative differences of the terms' gradients between two programs in f32, and that of their sums. Ratios divide by
/// small flows. The slope of bilinear reading jumps at whole pixels, which rounding places differently.
const ACCEPTED: [f64; 6] = [1e-4, 1e-4, 5e-3, 5e-3, 2e-2, 1e-5];
const ACCEPTED_OF_SUM: f64 = 2e-2;
/// Names of what takes a gradient.
const LEAVES: [&str; 4] = ["depth_t", "depth_s", "rotation", "translation"];

/// The loss core at one image size.
#[derive(Clone, Debug)]
pub struct LossCase {
    name: String,
    batch: usize,
    height: usize,
    width: usize,
    way: Way,
}

impl LossCase {
    /// The loss core of a batch of images.
    pub fn new(batch: usize, height: usize, width: usize) -> Self {
        Self { name: format!("loss core {width}x{height} b{batch}"), batch, height, width, way: Way::Fused }
    }

    /// The same as a graph of small operations: what fusing them brings.
    pub fn composed(batch: usize, height: usize, width: usize) -> Self {
        let fused = Self::new(batch, height, width);
        Self { name: format!("{}, composed", fused.name), way: Way::Composed, ..fused }
    }

    /// Bytes that must be read or written: three images, two depths, flow and mask, and the gradients of the depths.
    pub fn bytes(&self) -> f64 {
        4.0 * (self.batch * self.height * self.width * (3 * 3 + 2 + 2 + 1 + 2)) as f64
    }
}

impl Case for LossCase {
    fn topic(&self) -> &'static str {
        "loss_core"
    }

    fn name(&self) -> &str {
        &self.name
    }

    fn whats(&self) -> &'static [&'static str] {
        &["all", "geom", "photo"]
    }

    fn spec(&self) -> Value {
        json!({"name": self.name, "batch": self.batch, "height": self.height, "width": self.width})
    }

    fn build(&self, inputs: &Inputs) -> Result<Box<dyn Ours + Send>> {
        let (n, h, w) = (self.batch, self.height, self.width);
        let image = |name| inputs.tensor(name, Shape::new(n, 3, h, w));
        let map = |name| inputs.tensor(name, Shape::new(n, 1, h, w));
        let target = image("target")?;
        Ok(Box::new(LossCore {
            leaves: [
                map("depth_t")?,
                map("depth_s")?,
                inputs.tensor("rotation", Shape::new(2 * n, 1, 3, 3))?,
                inputs.tensor("translation", Shape::new(2 * n, 3, 1, 1))?,
            ],
            flow: inputs.tensor("flow", Shape::new(n, 2, h, w))?,
            mask: map("mask")?,
            target,
            sources: [image("previous")?, image("next")?],
            cameras: vec![camera(inputs, h, w)?; 2 * n],
            way: self.way,
            pool: Pool::new(),
        }))
    }
}

struct LossCore {
    leaves: [Tensor<f32>; 4],
    flow: Tensor<f32>,
    mask: Tensor<f32>,
    target: Tensor<f32>,
    /// Both sources, the previous one first.
    sources: [Tensor<f32>; 2],
    /// Cameras of the stacked samples.
    cameras: Vec<Intrinsics>,
    way: Way,
    pool: Arc<Pool<f32>>,
}

impl LossCore {
    fn samples(&self) -> usize {
        self.target.shape().n()
    }

    /// L_pla, L_axi, L_tan and L_rad of the first source, as `objective/geometric.rs` measures them.
    fn geometric<'t>(&self, [target_depth, source_depth, rotation, translation]: [Var<'t, f32>; 4]) -> [Var<'t, f32>; 4] {
        let n = self.samples();
        let inputs = PairInputs {
            target_depth,
            source_depth,
            flow: target_depth.tape().constant(self.flow.clone()),
            rotation: rotation.slice(0, 0, n),
            translation: translation.slice(0, 0, n),
            intrinsics: &self.cameras[..n],
            mask: &self.mask,
        };
        four(&inputs, &LossOptions::literal(), [true; 4], self.way)
    }

    /// Minimum reprojection with auto-mask as `objective/photometric.rs` measures it, and smoothness.
    fn photometric<'t>(&self, [depth, _, rotation, translation]: [Var<'t, f32>; 4]) -> [Var<'t, f32>; 2] {
        let tape = depth.tape();
        let target = tape.constant(self.target.clone());
        let identities = self.sources.each_ref().map(|source| photometric(tape.constant(source.clone()), target).value());
        let best = match self.way {
            Way::Fused => {
                let frames = Frames::new(tape, &self.target, &self.sources, &identities, Combine::Minimum);
                fused_reprojection(depth, Pose { rotation, translation }, &self.cameras, &frames).mean
            }
            Way::Composed => {
                let n = self.samples();
                let errors = [0, 1].map(|k| {
                    let of_source = |motion: Var<'t, f32>| motion.slice(0, k * n, n);
                    let flow = rigid_flow(depth, of_source(rotation), of_source(translation), &self.cameras[..n]);
                    let source = tape.constant(self.sources[k].clone());
                    photometric(warp(source, flow.slice(1, 0, 2), SamplePadding::Border), target)
                });
                min_reprojection(&errors, &identities).error.mean()
            }
        };
        [best, smoothness(depth.recip(), &self.target)]
    }

    /// The terms of a part with their weights, in the order of [`TERMS`].
    fn terms<'t>(&self, part: &str, leaves: [Var<'t, f32>; 4]) -> Vec<Var<'t, f32>> {
        match part {
            "geom" => self.geometric(leaves).to_vec(),
            "photo" => self.photometric(leaves).to_vec(),
            "all" => [&self.geometric(leaves)[..], &self.photometric(leaves)].concat(),
            _ => panic!("loss core: nothing called '{part}'"),
        }
    }

    fn leaves<'t>(&self, tape: &'t Tape<f32>) -> [Var<'t, f32>; 4] {
        self.leaves.each_ref().map(|value| tape.leaf(value.clone()))
    }
}

/// The weights of a part's terms.
fn weights(part: &str) -> &'static [(&'static str, f64)] {
    match part {
        "geom" => &TERMS[..4],
        "photo" => &TERMS[4..],
        _ => &TERMS,
    }
}

fn total<'t>(part: &str, terms: &[Var<'t, f32>]) -> Var<'t, f32> {
    let weighted = terms.iter().zip(weights(part)).map(|(term, (_, weight))| term.scale(*weight));
    weighted.reduce(Var::add).expect("every part has terms")
}

impl Ours for LossCore {
    fn repetition(&mut self, what: &str) -> Duration {
        let tape = Tape::with_pool(self.pool.clone());
        let leaves = self.leaves(&tape);
        timed(|| tape.backward_and_free(total(what, &self.terms(what, leaves))))
    }

    fn results(&mut self) -> Results {
        let mut results = Results::default();
        let tape = Tape::new();
        let leaves = self.leaves(&tape);
        let terms = self.terms("all", leaves);
        let mut gradients_of = |name: &str, loss, tolerance| {
            let gradients = tape.backward(loss);
            for (leaf, var) in LEAVES.into_iter().zip(leaves) {
                // Without a path to the leaf it is zero, whether or not the tape knows.
                let gradient = gradients.get(var).cloned().unwrap_or_else(|| Tensor::zeros(var.shape()));
                results.tensors.push((format!("{name}_grad_{leaf}"), gradient, tolerance));
            }
        };
        for ((&(name, _), &term), accepted) in TERMS.iter().zip(&terms).zip(ACCEPTED) {
            gradients_of(name, term, accepted);
        }
        for part in ["geom", "photo", "all"] {
            let chosen = if part == "geom" { &terms[..4] } else { &terms[4..] };
            gradients_of(part, total(part, if part == "all" { &terms } else { chosen }), ACCEPTED_OF_SUM);
        }
        for ((name, _), term) in TERMS.iter().zip(&terms) {
            results.values.push(((*name).into(), f64::from(term.value().item()), 1e-5));
        }
        results
    }
}
