//! `l_pho`: how well the warped sources look like the target, in the form that `loss.photometric` names.

use dimode_autodiff::ops::bilinear_sample::SamplePadding;
use dimode_autodiff::{Tensor, Var, rng};
use dimode_geometry::taped::{self, Pose};

use super::needs::Needs;
use super::scene::{Scene, twice};
use super::term::{Term, TermKind};
use super::view_pairs;
use crate::batch::join;
use crate::config::{LossConfig, Photometric, StageConfig};
use crate::losses::min_reprojection::{average_reprojection, min_reprojection};
use crate::losses::photometric::{photometric, photometric_value};

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
    let (n, tape) = (scene.samples(), scene.tape());
    let images = &scene.batch.plain;
    let sources = scene.sources();
    let target = join(&[&images.target, &images.target]);
    let identities = if scene.loss.auto_mask { identities(scene, &sources.value(), &target) } else { Vec::new() };
    let target = tape.constant(target);
    let mut total = None;
    let mut valid = 0.0;
    let scales = scene.leaves.disparities.len();
    for (scale, &disparity) in scene.leaves.disparities.iter().enumerate() {
        let rigid = if scale == 0 { scene.rigid() } else { rigid_at(scene, disparity) };
        let error = photometric(taped::warp(sources, rigid.slice(1, 0, 2), SamplePadding::Border), target);
        let of_sources = [error.slice(0, 0, n), error.slice(0, n, n)];
        let best = if scene.loss.average_sources { average_reprojection } else { min_reprojection }(&of_sources, &identities);
        valid += best.share / scales as f64;
        let mean = best.error.mean().scale(1.0 / scales as f64);
        total = Some(total.map_or(mean, |t: Var<'l, f32>| t.add(mean)));
    }
    Term::new("l_pho", scene.loss.photometric_weight, total.expect("at least one scale"), valid)
}

/// Errors of the unwarped sources with a little noise that breaks ties, one map for each source.
fn identities(scene: &Scene<'_, '_>, sources: &Tensor<f32>, target: &Tensor<f32>) -> Vec<Tensor<f32>> {
    let error = photometric_value(sources, target);
    let noise = rng::uniform::<f32>(scene.seed, error.shape(), 0.0, 2e-5);
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
fn rigid_at<'l>(scene: &Scene<'_, 'l>, disparity: Var<'l, f32>) -> Var<'l, f32> {
    let s = scene.depth.shape();
    let Pose { rotation, translation } = scene.motion();
    let depth = twice(scene.range.depth(disparity.resize_bilinear(s.h(), s.w(), false)));
    taped::rigid_flow(depth, rotation, translation, &scene.cameras)
}
