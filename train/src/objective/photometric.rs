//! `l_pho`: how well the warped sources look like the target, in the form that `loss.photometric` names.

use dimode_autodiff::ops::bilinear_sample::SamplePadding;
use dimode_autodiff::{Tensor, Var, par, rng};
use dimode_geometry::taped::{self, Pose};

use super::needs::Needs;
use super::scene::{Scene, twice};
use super::term::{Term, TermKind};
use super::view_pairs;
use crate::config::{LossConfig, Photometric, StageConfig};
use crate::losses::fused_reprojection::{Combine, Frames, FusedReprojection, fused_reprojection};
use crate::losses::min_reprojection::{average_reprojection, min_reprojection};
use crate::losses::photometric::photometric;

pub(super) const KIND: TermKind = TermKind { needs, measure };

fn needs(loss: &LossConfig, _: &StageConfig) -> Needs {
    if loss.photometric == Photometric::MinimumReprojection { Needs::default() } else { view_pairs::NEEDS }
}

fn measure<'l>(scene: &Scene<'_, 'l>) -> Vec<Term<'l>> {
    match scene.loss.photometric {
        Photometric::MinimumReprojection => vec![minimum_reprojection(scene)],
        Photometric::ScDepth | Photometric::ScSfm => {
            let pairs = scene.view_pairs();
            vec![Term::new("l_pho", scene.loss.photometric_weight, pairs.photo, pairs.valid)]
        }
    }
}

/// Minimum over the sources with auto-mask, mean over scales.
fn minimum_reprojection<'l>(scene: &Scene<'_, 'l>) -> Term<'l> {
    let (tape, images) = (scene.tape(), &scene.batch.plain);
    let combine = if scene.loss.average_sources { Combine::Average } else { Combine::Minimum };
    let measure: Box<dyn Fn(Var<'l, f32>) -> FusedReprojection<'l, f32>> = match scene.leaves.rectified {
        // Images without their rotation have gradients of their own.
        Some(sources) => {
            let (n, target) = (scene.samples(), tape.constant(images.target.clone()));
            let parts = [sources.slice(0, 0, n), sources.slice(0, n, n)];
            let identities = identities(scene, &parts.map(Var::value));
            Box::new(move |depth| composed(scene, depth, parts, target, &identities))
        }
        None => {
            let sources = [images.previous.clone(), images.next.clone()];
            let frames = Frames::new(tape, &images.target, &sources, &identities(scene, &sources), combine);
            Box::new(move |depth| fused_reprojection(depth, scene.motion(), &scene.cameras, &frames))
        }
    };
    let size = scene.target_depth().shape();
    let scales = scene.leaves.disparities.len();
    let mut total = None;
    let mut valid = 0.0;
    for (scale, &disparity) in scene.leaves.disparities.iter().enumerate() {
        let depth = match scale {
            0 => scene.target_depth(),
            _ => scene.range.depth(disparity.resize_bilinear(size.h(), size.w(), false)),
        };
        let FusedReprojection { mean, share } = measure(depth);
        valid += share / scales as f64;
        let mean = mean.scale(1.0 / scales as f64);
        total = Some(total.map_or(mean, |t: Var<'l, f32>| t.add(mean)));
    }
    Term::new("l_pho", scene.loss.photometric_weight, total.expect("at least one scale"), valid)
}

/// The same as [`fused_reprojection`], operation by operation, with gradients to the sources.
fn composed<'l>(
    scene: &Scene<'_, 'l>,
    depth: Var<'l, f32>,
    sources: [Var<'l, f32>; 2],
    target: Var<'l, f32>,
    identities: &[Tensor<f32>],
) -> FusedReprojection<'l, f32> {
    let (n, Pose { rotation, translation }) = (scene.samples(), scene.motion());
    let flow = taped::rigid_flow(twice(depth), rotation, translation, &scene.cameras);
    let error = |k: usize| {
        let flow = flow.slice(0, k * n, n).slice(1, 0, 2);
        photometric(taped::warp(sources[k], flow, SamplePadding::Border), target)
    };
    let best = if scene.loss.average_sources { average_reprojection } else { min_reprojection };
    let best = best(&[error(0), error(1)], identities);
    FusedReprojection { mean: best.error.mean(), share: best.share }
}

/// Errors of the unwarped sources with a little noise that breaks ties, one map for each source; none without auto-mask.
fn identities(scene: &Scene<'_, '_>, sources: &[Tensor<f32>; 2]) -> Vec<Tensor<f32>> {
    if !scene.loss.auto_mask {
        return Vec::new();
    }
    let (tape, seed) = (scene.tape(), scene.seed);
    let target = tape.constant(scene.batch.plain.target.clone());
    let errors = sources.each_ref().map(|source| photometric(tape.constant(source.clone()), target).value());
    let with_noise = |(k, error): (usize, &Tensor<f32>)| {
        let len = error.shape().len();
        let mut out = tape.scratch(len);
        par::for_each_chunk(&mut out, par::CHUNK, |i, out| {
            let first = i * par::CHUNK;
            for ((j, o), e) in (k * len + first..).zip(out.iter_mut()).zip(&error.data()[first..]) {
                *o = e + rng::uniform_at::<f32>(seed, j as u64, 0.0, 2e-5);
            }
        });
        tape.tensor(error.shape(), out)
    };
    errors.iter().enumerate().map(with_noise).collect()
}
