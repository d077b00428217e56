//! The total of Monodepth2 over several scales of disparity (nianticlabs/monodepth2, `trainer.py`).
//!
//! **Formula**: each disparity is resized to full size (bilinear, half-pixel centres) and mapped to depth, the sources are warped
//! into the target at full size, and `photo_s` is the mean over all pixels of the minimum over sources and identities;
//! `smooth_s` is the edge-aware smoothness of the disparity at its own size; the total is the mean over scales of
//! `photo_s + w smooth_s / 2^s`.

use dimode_autodiff::ops::bilinear_sample::SamplePadding;
use dimode_autodiff::{Scalar, Tensor, Var};
use dimode_geometry::Intrinsics;
use dimode_geometry::taped::{Divisor, Pose, back_project, project};

use super::fused_reprojection::{Combine, Frames, FusedReprojection, fused_reprojection};
use super::min_reprojection::min_reprojection;
use super::photometric::photometric;
use super::smoothness::smoothness;
use crate::model::DepthRange;

/// Monodepth2's weight of the smoothness.
pub const SMOOTHNESS: f64 = 1e-3;

/// How a source is read from a depth map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Reprojection {
    /// By [`rigid_flow()`](dimode_geometry::taped::rigid_flow()): points behind the camera do not move.
    #[default]
    RigidFlow,
    /// By division by `Z + 1e-7`, points behind the camera mirrored. For comparison with the public code.
    AsCoded,
}

/// One batch of `n` samples as the loss needs it.
#[derive(Clone, Copy, Debug)]
pub struct MultiScale<'a, 't, T: Scalar> {
    /// Disparities in (0, 1), full size first, `[n, 1, h_s, w_s]`.
    pub disparities: &'a [Var<'t, T>],
    /// How they become depth.
    pub range: DepthRange,
    /// The target at the size of each disparity, `[n, 3, h_s, w_s]`; the first one is warped to.
    pub targets: &'a [Tensor<T>],
    /// The sources at full size, `[n, 3, h, w]`.
    pub sources: &'a [Tensor<T>],
    /// `source_from_target` of each source.
    pub motions: &'a [Pose<'t, T>],
    /// One camera a sample, at full size.
    pub intrinsics: &'a [Intrinsics],
    /// Errors of the unmoved sources, `[n, 1, h, w]`, with the noise that breaks ties where it is wanted; empty: no auto-mask.
    pub identities: &'a [Tensor<T>],
    /// Weight of the smoothness, [`SMOOTHNESS`] in the public code.
    pub smoothness: f64,
    /// How sources are read.
    pub reprojection: Reprojection,
}

/// The parts of one scale.
#[derive(Clone, Copy, Debug)]
pub struct ScaleTerms<'t, T: Scalar> {
    /// Mean over all pixels of the minimum reprojection error.
    pub photo: Var<'t, T>,
    /// Smoothness before its weight.
    pub smooth: Var<'t, T>,
    /// Share of the pixels that a warped source won.
    pub share: f64,
}

/// The total and its parts, full size first.
#[derive(Clone, Debug)]
pub struct MultiScaleLoss<'t, T: Scalar> {
    /// Mean over the scales.
    pub total: Var<'t, T>,
    /// The parts.
    pub scales: Vec<ScaleTerms<'t, T>>,
}

/// The loss of a batch.
///
/// **Gradient**: to disparities and motions; images are data. Pixels that an unmoved source wins stay in the mean but carry none.
///
/// # Panics
/// When there is no disparity or source, or when numbers or shapes do not fit.
#[track_caller]
pub fn multi_scale<'t, T: Scalar>(input: &MultiScale<'_, 't, T>) -> MultiScaleLoss<'t, T> {
    let (scales, sources) = (input.disparities.len(), input.sources.len());
    assert!(scales > 0 && input.targets.len() == scales, "multi_scale: {} targets for {scales} scales", input.targets.len());
    assert!(sources > 0 && input.motions.len() == sources, "multi_scale: {} motions, {sources} sources", input.motions.len());
    let frames = input.frames();
    let terms: Vec<_> = (0..scales)
        .map(|s| {
            let FusedReprojection { mean, share } = input.error(s, frames.as_ref());
            ScaleTerms { photo: mean, smooth: smoothness(input.disparities[s], &input.targets[s]), share }
        })
        .collect();
    let of_scale = |(s, term): (usize, &ScaleTerms<'t, T>)| {
        let weight = input.smoothness / f64::from(1u32 << s);
        term.photo.add(term.smooth.scale(weight))
    };
    let sum = terms.iter().enumerate().map(of_scale).reduce(|a, b| a.add(b)).expect("at least one scale");
    MultiScaleLoss { total: sum.scale(1.0 / scales as f64), scales: terms }
}

impl<'t, T: Scalar> MultiScale<'_, 't, T> {
    /// What reads the sources: prepared images, or nothing where they are read as coded.
    #[track_caller]
    fn frames(&self) -> Option<Frames<T>> {
        let tape = self.disparities[0].tape();
        let fused = self.reprojection == Reprojection::RigidFlow;
        fused.then(|| Frames::new(tape, &self.targets[0], self.sources, self.identities, Combine::Minimum))
    }

    /// The minimum reprojection error by the disparity of scale `s`.
    #[track_caller]
    fn error(&self, s: usize, frames: Option<&Frames<T>>) -> FusedReprojection<'t, T> {
        let full = self.targets[0].shape();
        let depth = self.range.depth(self.disparities[s].resize_bilinear(full.h(), full.w(), false));
        match frames {
            Some(frames) => {
                let rotation = Var::concat(&self.motions.iter().map(|m| m.rotation).collect::<Vec<_>>(), 0);
                let translation = Var::concat(&self.motions.iter().map(|m| m.translation).collect::<Vec<_>>(), 0);
                let cameras = self.intrinsics.repeat(self.sources.len());
                fused_reprojection(depth, Pose { rotation, translation }, &cameras, frames)
            }
            None => self.error_as_coded(depth),
        }
    }

    #[track_caller]
    fn error_as_coded(&self, depth: Var<'t, T>) -> FusedReprojection<'t, T> {
        let tape = depth.tape();
        let target = tape.constant(self.targets[0].clone());
        let points = back_project(depth, self.intrinsics);
        let error = |(source, &Pose { rotation, translation }): (&Tensor<T>, &Pose<'t, T>)| {
            let seen = project(points, rotation, translation, self.intrinsics, Divisor::PlusGuard);
            photometric(tape.constant(source.clone()).bilinear_sample(seen.pixels, SamplePadding::Border), target)
        };
        let errors: Vec<_> = self.sources.iter().zip(self.motions).map(error).collect();
        let best = min_reprojection(&errors, self.identities);
        FusedReprojection { mean: best.error.mean(), share: best.share }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::gradcheck::random;
    use dimode_autodiff::{GradCheck, Shape, Tape, gradcheck};
    use dimode_geometry::taped::RotationForm;
    use dimode_geometry::taped::so3_exp::rotation_matrix;

    use crate::losses::photometric::photometric_value;

    const RANGE: DepthRange = DepthRange { min: 1.0, max: 20.0 };

    struct Data {
        targets: Vec<Tensor<f64>>,
        sources: Vec<Tensor<f64>>,
        inputs: Vec<Tensor<f64>>,
    }

    fn data() -> Data {
        let image = |seed, h, w| random(seed, Shape::new(2, 3, h, w), 0.0, 1.0);
        let vector = |seed, size: f64| random(seed, Shape::new(2, 3, 1, 1), -size, size);
        Data {
            targets: vec![image(1, 8, 10), image(2, 4, 5)],
            sources: vec![image(3, 8, 10), image(4, 8, 10)],
            inputs: vec![
                random(5, Shape::new(2, 1, 8, 10), 0.2, 0.8),
                random(6, Shape::new(2, 1, 4, 5), 0.2, 0.8),
                vector(7, 0.03),
                vector(8, 0.1),
                vector(9, 0.03),
                vector(10, 0.1),
            ],
        }
    }

    /// Two disparities, then rotation vector and translation of two sources.
    fn loss<'t>(
        data: &Data,
        v: &[Var<'t, f64>],
        identities: &[Tensor<f64>],
        reprojection: Reprojection,
    ) -> MultiScaleLoss<'t, f64> {
        let motions = [2, 4].map(|k| Pose { rotation: rotation_matrix(v[k], RotationForm::Exponential), translation: v[k + 1] });
        multi_scale(&MultiScale {
            disparities: &v[..2],
            range: RANGE,
            targets: &data.targets,
            sources: &data.sources,
            motions: &motions,
            intrinsics: &[Intrinsics::new(9.0, 9.5, 4.4, 3.6, 10, 8).unwrap(); 2],
            identities,
            smoothness: 0.1,
            reprojection,
        })
    }

    fn leaves<'t>(tape: &'t Tape<f64>, data: &Data) -> Vec<Var<'t, f64>> {
        data.inputs.iter().map(|x| tape.leaf(x.clone())).collect()
    }

    #[test]
    fn gradients_match_finite_differences() {
        let data = data();
        let check = GradCheck { step: 1e-6, rtol: 1e-5, atol: 1e-8, ..GradCheck::default() };
        for reprojection in [Reprojection::RigidFlow, Reprojection::AsCoded] {
            let report = gradcheck(&data.inputs, |_, v| loss(&data, v, &[], reprojection).total, check);
            assert!(report.is_ok(), "{reprojection:?}: {report}");
        }
    }

    #[test]
    fn the_total_is_the_mean_of_its_parts_and_both_ways_to_read_agree() {
        let data = data();
        let identities: Vec<_> = data.sources.iter().map(|s| photometric_value(s, &data.targets[0])).collect();
        let tape = Tape::new();
        let v = leaves(&tape, &data);
        let found = loss(&data, &v, &identities, Reprojection::RigidFlow);
        let part = |s: usize| found.scales[s].photo.value().item() + 0.1 * found.scales[s].smooth.value().item() / [1.0, 2.0][s];
        assert!((found.total.value().item() - (part(0) + part(1)) / 2.0).abs() < 1e-15);
        assert!(found.scales.iter().all(|s| s.share > 0.1 && s.share < 0.9));
        let coded = loss(&data, &v, &identities, Reprojection::AsCoded);
        assert!((found.total.value().item() - coded.total.value().item()).abs() < 1e-6);
    }

    #[test]
    fn identities_that_win_everywhere_leave_only_the_smoothness_to_pull() {
        let data = data();
        let nothing = vec![Tensor::zeros(Shape::new(2, 1, 8, 10)); 2];
        let tape = Tape::new();
        let v = leaves(&tape, &data);
        let found = loss(&data, &v, &nothing, Reprojection::RigidFlow);
        assert!(found.scales.iter().all(|s| s.share == 0.0 && s.photo.value().item() == 0.0));
        let grads = tape.backward(found.total);
        assert!(v[2..].iter().all(|&x| grads.wrt(x).data().iter().all(|&g| g == 0.0)));
        assert!(v[..2].iter().all(|&x| grads.wrt(x).data().iter().any(|&g| g != 0.0)));
    }

    #[test]
    fn the_order_of_the_samples_does_not_matter() {
        let data = data();
        let swap = |x: &Tensor<f64>| {
            let (a, b) = x.data().split_at(x.shape().len() / 2);
            Tensor::from_vec(x.shape(), [b, a].concat())
        };
        let all = |x: &[Tensor<f64>]| x.iter().map(swap).collect::<Vec<_>>();
        let swapped = Data { targets: all(&data.targets), sources: all(&data.sources), inputs: all(&data.inputs) };
        let value = |data: &Data| {
            let tape = Tape::new();
            loss(data, &leaves(&tape, data), &[], Reprojection::RigidFlow).total.value().item()
        };
        assert!((value(&data) - value(&swapped)).abs() < 1e-14);
    }
}
