//! Each loss by itself, forward and backward, on one sample of 640 x 192.
//!
//! The geometric losses go the way of training: one operation, asked for one loss or for all four.

use std::sync::Arc;
use std::time::Duration;

use anyhow::Result;
use dimode::losses::census::{CensusForm, census};
use dimode::losses::cross_task::cross_task;
use dimode::losses::depth_ranking::{Pair, depth_ranking, global_pairs, random_global_pairs};
use dimode::losses::local_structure::normal_matching;
use dimode::losses::photometric::photometric;
use dimode::losses::smoothness::smoothness;
use dimode_autodiff::{Pool, Shape, Tape, Tensor, Var};
use dimode_geometry::Intrinsics;
use dimode_geometry::losses::fused::geometric_losses;
use dimode_geometry::losses::{AlignedPair, LossOptions, PairInputs, axial, planar, radial, tangential};
use serde_json::{Value, json};

use crate::camera::camera;
use crate::case::{Case, Ours, Results, timed};
use crate::inputs::Inputs;

const H: usize = 192;
const W: usize = 640;

/// One loss, or the four geometric ones together.
#[derive(Clone, Debug)]
pub struct TermCase {
    name: &'static str,
    loss: Loss,
    /// Largest relative difference of its gradients between two programs in f32.
    accepted: f64,
}

/// Which loss.
#[derive(Clone, Copy, Debug)]
enum Loss {
    /// L_pla, L_axi, L_tan, L_rad: those that are wanted, added up.
    Geometric { form: Form, wanted: [bool; 4], way: Way },
    /// The photometric error of two images.
    Photometric,
    /// Edge-aware smoothness of the disparity.
    Smoothness,
    /// ARFlow's census loss of two images.
    Census,
    /// Normals against those of a pseudo-depth.
    NormalMatching,
    /// Confident depth ranking, global pairs.
    DepthRanking,
    /// Rigid against optical flow.
    CrossTask,
}

/// Forms of the geometric losses.
#[derive(Clone, Copy, Debug)]
enum Form {
    /// The equations of the paper.
    Printed,
    /// Residuals in the image: the default of training.
    Pixels,
}

/// How the geometric losses are computed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Way {
    /// In one operation, as in training.
    Fused,
    /// As a graph of small operations: what the other way is tested against.
    Composed,
}

const fn geometric(name: &'static str, form: Form, wanted: [bool; 4], accepted: f64) -> TermCase {
    TermCase { name, loss: Loss::Geometric { form, wanted, way: Way::Fused }, accepted }
}

const fn term(name: &'static str, loss: Loss, accepted: f64) -> TermCase {
    TermCase { name, loss, accepted }
}

const PLANAR: [bool; 4] = [true, false, false, false];
const AXIAL: [bool; 4] = [false, true, false, false];
const TANGENTIAL: [bool; 4] = [false, false, true, false];
const RADIAL: [bool; 4] = [false, false, false, true];
const FOUR: [bool; 4] = [true; 4];

/// The losses. Printed ratios divide by small flows; residuals in pixels have a kink where they pass the noise of the flow.
pub const LOSSES: [TermCase; 16] = [
    geometric("planar, as printed", Form::Printed, PLANAR, 1e-4),
    geometric("axial, as printed", Form::Printed, AXIAL, 1e-4),
    geometric("tangential, as printed", Form::Printed, TANGENTIAL, 5e-3),
    geometric("radial, as printed", Form::Printed, RADIAL, 5e-3),
    geometric("all four, as printed", Form::Printed, FOUR, 5e-3),
    geometric("planar, in pixels", Form::Pixels, PLANAR, 3e-3),
    geometric("axial, in pixels", Form::Pixels, AXIAL, 3e-3),
    geometric("tangential, in pixels", Form::Pixels, TANGENTIAL, 3e-3),
    geometric("radial, in pixels", Form::Pixels, RADIAL, 3e-3),
    geometric("all four, in pixels", Form::Pixels, FOUR, 3e-3),
    term("photometric", Loss::Photometric, 1e-4),
    term("smoothness", Loss::Smoothness, 1e-5),
    term("census", Loss::Census, 1e-5),
    term("normal matching", Loss::NormalMatching, 1e-4),
    term("depth ranking", Loss::DepthRanking, 1e-5),
    term("cross task", Loss::CrossTask, 1e-5),
];

/// The geometric losses as a graph of small operations, without a peer: what fusing them brings.
pub const COMPOSED: [TermCase; 2] =
    [composed("all four, as printed, composed", Form::Printed), composed("all four, in pixels, composed", Form::Pixels)];

const fn composed(name: &'static str, form: Form) -> TermCase {
    TermCase { name, loss: Loss::Geometric { form, wanted: FOUR, way: Way::Composed }, accepted: 0.0 }
}

impl Loss {
    /// Names of what takes a gradient.
    fn leaves(self) -> &'static [&'static str] {
        match self {
            Self::Geometric { .. } => &["depth_t", "depth_s", "rotation", "translation"],
            Self::Photometric | Self::Census => &["next"],
            Self::Smoothness | Self::NormalMatching | Self::DepthRanking => &["depth_t"],
            Self::CrossTask => &["flow", "other_flow"],
        }
    }

    /// Name and form for the peer.
    fn spec(self) -> (&'static str, Value) {
        match self {
            Self::Geometric { form, wanted, .. } => (
                "geometric",
                json!({"form": match form { Form::Printed => "printed", Form::Pixels => "pixels" }, "wanted": wanted}),
            ),
            Self::Photometric => ("photometric", Value::Null),
            Self::Smoothness => ("smoothness", Value::Null),
            Self::Census => ("census", Value::Null),
            Self::NormalMatching => ("normal_matching", Value::Null),
            Self::DepthRanking => ("depth_ranking", Value::Null),
            Self::CrossTask => ("cross_task", Value::Null),
        }
    }
}

impl Case for TermCase {
    fn topic(&self) -> &'static str {
        "losses"
    }

    fn name(&self) -> &str {
        self.name
    }

    fn whats(&self) -> &'static [&'static str] {
        &["forward_backward"]
    }

    fn spec(&self) -> Value {
        let (loss, options) = self.loss.spec();
        json!({"name": self.name, "loss": loss, "options": options, "leaves": self.loss.leaves(), "height": H, "width": W})
    }

    fn build(&self, inputs: &Inputs) -> Result<Box<dyn Ours + Send>> {
        Ok(Box::new(Term { case: self.clone(), scene: Scene::new(inputs)?, pool: Pool::new() }))
    }
}

/// One sample: everything that any of the losses reads.
struct Scene {
    target: Tensor<f32>,
    next: Tensor<f32>,
    depth_t: Tensor<f32>,
    depth_s: Tensor<f32>,
    flow: Tensor<f32>,
    other_flow: Tensor<f32>,
    rotation: Tensor<f32>,
    translation: Tensor<f32>,
    mask: Tensor<f32>,
    cameras: [Intrinsics; 1],
    pairs: Vec<Pair>,
}

impl Scene {
    fn new(inputs: &Inputs) -> Result<Self> {
        let map = |name: &str, c: usize| inputs.tensor(name, Shape::new(1, c, H, W));
        // The scene has a motion to either source; that to the first one counts here.
        let motion = |name: &str, of_one: Shape| -> Result<Tensor<f32>> {
            let both = inputs.tensor(name, Shape([2, of_one.c(), of_one.h(), of_one.w()]))?;
            Ok(Tensor::from_vec(of_one, both.data()[..of_one.len()].to_vec()))
        };
        Ok(Self {
            target: map("target", 3)?,
            next: map("next", 3)?,
            depth_t: map("depth_t", 1)?,
            depth_s: map("depth_s", 1)?,
            flow: map("flow", 2)?,
            other_flow: map("other_flow", 2)?,
            rotation: motion("rotation", Shape::new(1, 1, 3, 3))?,
            translation: motion("translation", Shape::new(1, 3, 1, 1))?,
            mask: map("mask", 1)?,
            cameras: [camera(inputs, H, W)?],
            pairs: pairs(inputs)?,
        })
    }

    fn named(&self, name: &str) -> &Tensor<f32> {
        match name {
            "next" => &self.next,
            "depth_t" => &self.depth_t,
            "depth_s" => &self.depth_s,
            "flow" => &self.flow,
            "other_flow" => &self.other_flow,
            "rotation" => &self.rotation,
            "translation" => &self.translation,
            _ => panic!("losses: nothing called '{name}'"),
        }
    }

    /// The loss of its leaves, in their order.
    fn loss<'t>(&self, loss: Loss, v: &[Var<'t, f32>]) -> Var<'t, f32> {
        let target = || v[0].tape().constant(self.target.clone());
        match loss {
            Loss::Geometric { form, wanted, way } => {
                let options = match form {
                    Form::Printed => LossOptions::literal(),
                    Form::Pixels => LossOptions::default(),
                };
                let inputs = PairInputs {
                    target_depth: v[0],
                    source_depth: v[1],
                    flow: v[0].tape().constant(self.flow.clone()),
                    rotation: v[2],
                    translation: v[3],
                    intrinsics: &self.cameras,
                    mask: &self.mask,
                };
                let chosen = four(&inputs, &options, wanted, way).into_iter().zip(wanted).filter(|(_, wanted)| *wanted);
                chosen.map(|(loss, _)| loss).reduce(Var::add).expect("at least one is wanted")
            }
            Loss::Photometric => photometric(v[0], target()).mean(),
            Loss::Smoothness => smoothness(v[0].recip(), &self.target),
            Loss::Census => census(v[0], target(), &self.mask, CensusForm::ArFlow),
            Loss::NormalMatching => normal_matching(v[0], &self.depth_s, &self.cameras),
            Loss::DepthRanking => depth_ranking(v[0], &self.depth_s, &self.pairs, &[]),
            Loss::CrossTask => cross_task(v[0], v[1], &self.mask),
        }
    }
}

/// Means of L_pla, L_axi, L_tan and L_rad; without meaning where they are not wanted.
pub(super) fn four<'t>(
    inputs: &PairInputs<'_, 't, f32>,
    options: &LossOptions,
    wanted: [bool; 4],
    way: Way,
) -> [Var<'t, f32>; 4] {
    if way == Way::Fused {
        return geometric_losses(inputs, options, wanted).expect("these forms have kernels").map(|loss| loss.mean);
    }
    let pair = AlignedPair::new(inputs, options);
    [planar(&pair, options), axial(&pair, options), tangential(&pair, options), radial(&pair, options)].map(|loss| loss.mean)
}

/// Pairs of pixels of the ranking: a random tenth against its permutation.
fn pairs(inputs: &Inputs) -> Result<Vec<Pair>> {
    if let Inputs::Drawn = inputs {
        return Ok(random_global_pairs(H * W, 1));
    }
    let row = |name: &str| inputs.tensor(name, Shape::new(1, 1, H, W));
    let chosen: Vec<bool> = row("ranking_mask")?.data().iter().map(|&x| x > 0.0).collect();
    // Numbers below 2^24 are exact in f32.
    let permutation: Vec<usize> = row("ranking_permutation")?.data().iter().map(|&x| x as usize).collect();
    Ok(global_pairs(&chosen, &permutation))
}

struct Term {
    case: TermCase,
    scene: Scene,
    pool: Arc<Pool<f32>>,
}

impl Term {
    fn leaves<'t>(&self, tape: &'t Tape<f32>) -> Vec<Var<'t, f32>> {
        self.case.loss.leaves().iter().map(|name| tape.leaf(self.scene.named(name).clone())).collect()
    }
}

impl Ours for Term {
    fn repetition(&mut self, _: &str) -> Duration {
        let tape = Tape::with_pool(self.pool.clone());
        let leaves = self.leaves(&tape);
        timed(|| tape.backward_and_free(self.scene.loss(self.case.loss, &leaves)))
    }

    fn results(&mut self) -> Results {
        let tape = Tape::new();
        let leaves = self.leaves(&tape);
        let loss = self.scene.loss(self.case.loss, &leaves);
        let gradients = tape.backward(loss);
        let mut results = Results::default();
        for (name, leaf) in self.case.loss.leaves().iter().zip(leaves) {
            // Without a path to the leaf it is zero, whether or not the tape knows.
            let gradient = gradients.get(leaf).cloned().unwrap_or_else(|| Tensor::zeros(leaf.shape()));
            results.tensors.push((format!("grad_{name}"), gradient, self.case.accepted));
        }
        results.values.push(("loss".into(), f64::from(loss.value().item()), 1e-5));
        results
    }
}
