//! The loss core, forward and backward, at 640 x 192 and at nano size: warp, photometric error and minimum over sources with
//! auto-mask, and the aligned pair with L_pla, L_axi, L_tan and L_rad in the literal form and in the one that training uses by
//! default, each composed of operations and as one; smoothness.

use criterion::{Criterion, criterion_group, criterion_main};
use dimode::losses::fused_reprojection::{Combine, Frames, fused_reprojection};
use dimode::losses::min_reprojection::min_reprojection;
use dimode::losses::photometric::photometric;
use dimode::losses::smoothness::smoothness;
use dimode_autodiff::ops::bilinear_sample::SamplePadding;
use dimode_autodiff::rng::uniform;
use dimode_autodiff::{Pool, Shape, Tape, Tensor, Var};
use dimode_benches::random_images;
use dimode_geometry::Intrinsics;
use dimode_geometry::losses::fused::geometric_losses;
use dimode_geometry::losses::{AlignedPair, LossOptions, LossTerm, PairInputs, axial, planar, radial, tangential};
use dimode_geometry::taped::{self, Pose, RotationForm, masks};

/// Samples, height, width.
const SIZES: [(usize, usize, usize); 3] = [(1, 192, 640), (4, 192, 640), (8, 64, 128)];

/// Random depths and motions before one camera.
struct Scene {
    depth: Tensor<f32>,
    source_depth: Tensor<f32>,
    rotation: Tensor<f32>,
    translation: Tensor<f32>,
    cameras: Vec<Intrinsics>,
}

impl Scene {
    fn new(n: usize, h: usize, w: usize) -> Self {
        let (map, vector) = (Shape::new(n, 1, h, w), Shape::new(n, 3, 1, 1));
        let focal = 0.6 * w as f64;
        let camera = Intrinsics::new(focal, focal, w as f64 / 2.0, h as f64 / 2.0, w, h).expect("a sane camera");
        Self {
            depth: uniform(4, map, 2.0, 40.0),
            source_depth: uniform(7, map, 2.0, 40.0),
            rotation: uniform(5, vector, -0.01, 0.01),
            translation: uniform(6, vector, -0.5, 0.5),
            cameras: vec![camera; n],
        }
    }

    /// Depth and motion as leaves of a tape.
    fn leaves<'t>(&self, tape: &'t Tape<f32>) -> [Var<'t, f32>; 3] {
        [&self.depth, &self.rotation, &self.translation].map(|values| tape.leaf(values.clone()))
    }

    /// The flow of the scene, half a pixel off.
    fn observed_flow(&self) -> Tensor<f32> {
        let tape = Tape::new();
        let [depth, rotation, translation] = self.leaves(&tape);
        let Pose { rotation, translation } = pose(rotation, translation, false);
        let flow = taped::rigid_flow(depth, rotation, translation, &self.cameras).slice(1, 0, 2);
        flow.add(tape.constant(uniform(8, flow.shape(), -0.5, 0.5))).value()
    }
}

fn pose<'t>(rotation: Var<'t, f32>, translation: Var<'t, f32>, invert: bool) -> Pose<'t, f32> {
    taped::source_from_target(rotation, translation, invert, RotationForm::Exponential)
}

/// Motions to the previous frame, then to the next one.
fn both_motions<'t>(rotation: Var<'t, f32>, translation: Var<'t, f32>) -> [Pose<'t, f32>; 2] {
    [pose(rotation, translation, true), pose(rotation, translation, false)]
}

fn photometric_core(c: &mut Criterion) {
    for (n, h, w) in SIZES {
        let scene = Scene::new(n, h, w);
        let images = random_images(Shape::new(n, 3, h, w));
        let sources = [images.previous.clone(), images.next.clone()];
        let pool = Pool::new();
        c.bench_function(&format!("warp + photometric + minimum, composed/{w}x{h} b{n}"), |b| {
            b.iter(|| {
                let tape = Tape::with_pool(pool.clone());
                let [depth, rotation, translation] = scene.leaves(&tape);
                let target = tape.constant(images.target.clone());
                let identities = sources.each_ref().map(|source| photometric(tape.constant(source.clone()), target).value());
                let motions = both_motions(rotation, translation);
                let errors = [0, 1].map(|k| {
                    let flow = taped::rigid_flow(depth, motions[k].rotation, motions[k].translation, &scene.cameras);
                    let source = tape.constant(sources[k].clone());
                    photometric(taped::warp(source, flow.slice(1, 0, 2), SamplePadding::Border), target)
                });
                tape.backward(min_reprojection(&errors, &identities).error.mean())
            });
        });
        c.bench_function(&format!("warp + photometric + minimum, fused/{w}x{h} b{n}"), |b| {
            b.iter(|| {
                let tape = Tape::with_pool(pool.clone());
                let [depth, rotation, translation] = scene.leaves(&tape);
                let target = tape.constant(images.target.clone());
                let identities = sources.each_ref().map(|source| photometric(tape.constant(source.clone()), target).value());
                let frames = Frames::new(&tape, &images.target, &sources, &identities, Combine::Minimum);
                let motions = both_motions(rotation, translation);
                let motion = Pose {
                    rotation: Var::concat(&motions.map(|m| m.rotation), 0),
                    translation: Var::concat(&motions.map(|m| m.translation), 0),
                };
                tape.backward(fused_reprojection(depth, motion, &scene.cameras.repeat(2), &frames).mean)
            });
        });
        c.bench_function(&format!("smoothness/{w}x{h} b{n}"), |b| {
            b.iter(|| {
                let tape = Tape::with_pool(pool.clone());
                let [depth, ..] = scene.leaves(&tape);
                tape.backward(smoothness(depth, &images.target))
            });
        });
    }
}

/// The four losses of a batch.
type Losses = for<'t> fn(&PairInputs<'_, 't, f32>, &LossOptions) -> [LossTerm<'t, f32>; 4];

fn composed<'t>(inputs: &PairInputs<'_, 't, f32>, options: &LossOptions) -> [LossTerm<'t, f32>; 4] {
    let pair = AlignedPair::new(inputs, options);
    [planar(&pair, options), axial(&pair, options), tangential(&pair, options), radial(&pair, options)]
}

fn fused<'t>(inputs: &PairInputs<'_, 't, f32>, options: &LossOptions) -> [LossTerm<'t, f32>; 4] {
    geometric_losses(inputs, options, [true; 4]).expect("forms with kernels")
}

fn geometric_core(c: &mut Criterion) {
    for (form, options) in [("literal", LossOptions::literal()), ("default", LossOptions::default())] {
        for (n, h, w) in SIZES {
            let scene = Scene::new(n, h, w);
            let (flow, mask) = (scene.observed_flow(), masks::everywhere(scene.depth.shape()));
            for (how, losses) in [("composed", composed as Losses), ("fused", fused)] {
                let pool = Pool::new();
                c.bench_function(&format!("aligned pair + four losses, {form}, {how}/{w}x{h} b{n}"), |b| {
                    b.iter(|| {
                        let tape = Tape::with_pool(pool.clone());
                        let [target_depth, rotation, translation] = scene.leaves(&tape);
                        let Pose { rotation, translation } = pose(rotation, translation, false);
                        let inputs = PairInputs {
                            target_depth,
                            source_depth: tape.leaf(scene.source_depth.clone()),
                            flow: tape.constant(flow.clone()),
                            rotation,
                            translation,
                            intrinsics: &scene.cameras,
                            mask: &mask,
                        };
                        let means = losses(&inputs, &options).map(|loss| loss.mean);
                        tape.backward(means.into_iter().reduce(Var::add).expect("four losses"))
                    });
                });
            }
        }
    }
}

criterion_group!(benches, photometric_core, geometric_core);
criterion_main!(benches);
