//! Camera motion of pairs of images: the pose network, and its refinement by looking again.
//!
//! After the first look the source is warped to the target with the depth of the target and the motion that was said; the next
//! look sees what is left between the two, and what it says is composed with what was said before. A network that looks once has
//! to know a motion to a fraction of itself; looking again it sees the remaining parallax, which is small and tells how
//! rotation and translation were confused. The reference network looks once.

use dimode_autodiff::ops::bilinear_sample::SamplePadding;
use dimode_autodiff::{Pool, Tape, Tensor, Var};
use dimode_geometry::taped::{self, Pose, RotationForm};
use dimode_geometry::{Intrinsics, Se3};
use dimode_nets::{Binder, Mode, ParamSet};

use crate::inference::Buffers;
use crate::model::Model;

/// Pairs of images `[n, 3, h, w]` whose motion `source_from_target` is asked for.
#[derive(Clone, Copy, Debug)]
pub struct Pairs<'a> {
    /// Target images.
    pub target: &'a Tensor<f32>,
    /// Source images.
    pub source: &'a Tensor<f32>,
    /// How many of the pairs, from the first on, have a source that was taken before the target. The network always sees the
    /// earlier image first.
    pub earlier: usize,
    /// Depth of the targets `[n, 1, h, w]`; not used when there is one look only.
    pub depth: Option<&'a Tensor<f32>>,
    /// Cameras, one a pair.
    pub cameras: &'a [Intrinsics],
}

impl Model {
    /// Motions `source_from_target` in a number of looks, on the tape. Every look passes a gradient to the network; none passes
    /// through the warp.
    ///
    /// # Panics
    /// When there is more than one look and no depth, or when a shape does not fit.
    pub fn source_from_target<'t>(&self, binder: &mut Binder<'t, f32>, pairs: &Pairs<'_>, looks: usize) -> Pose<'t, f32> {
        let first = self.first_look(binder, pairs);
        self.refined(binder, pairs, first, looks)
    }

    /// What the network says of the pairs as they are. Needs no depth.
    pub fn first_look<'t>(&self, binder: &mut Binder<'t, f32>, pairs: &Pairs<'_>) -> Pose<'t, f32> {
        let [target, source] = [pairs.target, pairs.source].map(|x| binder.tape().constant(x.clone()));
        let pose = self.look(binder, target, source, pairs.earlier);
        [target, source].into_iter().for_each(Var::release);
        pose
    }

    /// What was said at the first look, after all others of a number of `looks`.
    ///
    /// # Panics
    /// When there is more than one look and no depth, or when a shape does not fit.
    pub fn refined<'t>(
        &self,
        binder: &mut Binder<'t, f32>,
        pairs: &Pairs<'_>,
        first: Pose<'t, f32>,
        looks: usize,
    ) -> Pose<'t, f32> {
        let mut pose = first;
        for _ in 1..looks {
            let [target, source] = [pairs.target, pairs.source].map(|x| binder.tape().constant(x.clone()));
            let depth = binder.tape().constant(pairs.depth.expect("a second look needs depth").clone());
            let seen = warped(source, depth, pose.detach(), pairs.cameras);
            pose = pose.compose(self.look(binder, target, seen, pairs.earlier));
            [target, source, seen, depth].into_iter().for_each(Var::release);
        }
        pose
    }

    /// Motions `source_from_target` in a number of looks, as values.
    ///
    /// # Panics
    /// As [`Model::source_from_target`].
    pub fn motions(&self, pose: &ParamSet<f32>, mode: Mode, pairs: &Pairs<'_>, looks: usize) -> Vec<Se3> {
        self.motions_in(&Pool::new(), pose, mode, pairs, looks)
    }

    /// The same over buffers that stay.
    ///
    /// # Panics
    /// As [`Model::source_from_target`].
    pub fn motions_in(&self, buffers: &Buffers, pose: &ParamSet<f32>, mode: Mode, pairs: &Pairs<'_>, looks: usize) -> Vec<Se3> {
        let tape = Tape::with_pool(buffers.clone());
        let mut binder = Binder::selective(&tape, pose, mode, |_| false);
        self.source_from_target(&mut binder, pairs, looks).to_se3()
    }

    /// One look: the first `earlier` sources come before their targets.
    fn look<'t>(
        &self,
        binder: &mut Binder<'t, f32>,
        target: Var<'t, f32>,
        source: Var<'t, f32>,
        earlier: usize,
    ) -> Pose<'t, f32> {
        let n = target.shape().n();
        let split = |before: Var<'t, f32>, after: Var<'t, f32>| match earlier {
            0 => after,
            _ if earlier == n => before,
            _ => {
                let parts = [before.slice(0, 0, earlier), after.slice(0, earlier, n - earlier)];
                let joined = Var::concat(&parts, 0);
                parts.into_iter().for_each(Var::release);
                joined
            }
        };
        let (first, second) = (split(source, target), split(target, source));
        let [rotation, translation] = self.motion(binder, first, second);
        if (1..n).contains(&earlier) {
            first.release();
            second.release();
        }
        let said = |invert| taped::source_from_target(rotation, translation, invert, RotationForm::Exponential);
        let (back, forth) = (said(true), said(false));
        Pose { rotation: split(back.rotation, forth.rotation), translation: split(back.translation, forth.translation) }
    }
}

/// The sources as they would look from the targets' places if depth and motion were right.
fn warped<'t>(source: Var<'t, f32>, depth: Var<'t, f32>, pose: Pose<'t, f32>, cameras: &[Intrinsics]) -> Var<'t, f32> {
    let flow = taped::rigid_flow(depth, pose.rotation, pose.translation, cameras).slice(1, 0, 2);
    taped::warp(source, flow, SamplePadding::Border)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::NetsConfig;
    use crate::model::Weights;
    use dimode_autodiff::gradcheck::{random, weighted_sum};
    use dimode_autodiff::{Shape, Var};

    const N: usize = 2;

    struct Setting {
        model: Model,
        looks: usize,
        weights: Weights,
        target: Tensor<f32>,
        source: Tensor<f32>,
        depth: Tensor<f32>,
        cameras: Vec<Intrinsics>,
    }

    impl Setting {
        fn new(looks: usize) -> Self {
            let nets = NetsConfig { rotation_scale: 500.0, tangential_scale: 100.0, ..Default::default() };
            let model = Model::new(&nets);
            let weights = model.init(3);
            let image = |seed, from: f64| random::<f32>(seed, Shape::new(N, 3, 64, 64), from, 1.0);
            let cameras = vec![Intrinsics::new(50.0, 48.0, 31.0, 31.5, 64, 64).unwrap(); N];
            let depth = random(7, Shape::new(N, 1, 64, 64), 0.3, 0.8);
            Setting { model, looks, weights, target: image(5, 0.0), source: image(6, -0.5), depth, cameras }
        }

        fn pairs(&self, earlier: usize) -> Pairs<'_> {
            let Setting { target, source, depth, cameras, .. } = self;
            Pairs { target, source, earlier, depth: Some(depth), cameras }
        }

        fn said(&self, pairs: &Pairs<'_>) -> Vec<Se3> {
            self.model.motions(&self.weights.pose, Mode::Eval, pairs, self.looks)
        }

        /// The sources read where the target's pixels went, point by point.
        fn warped(&self, motions: &[Se3]) -> Tensor<f32> {
            let s = self.source.shape();
            Tensor::from_fn(s, |n, c, v, u| {
                let camera = &self.cameras[n];
                let point = camera.ray(u as f64, v as f64) * f64::from(self.depth.at(n, 0, v, u));
                let at = camera.project(&motions[n].transform(&point)).unwrap();
                let (x, y) = (at.x.clamp(0.0, (s.w() - 1) as f64), at.y.clamp(0.0, (s.h() - 1) as f64));
                let (i, j) = ((x as usize).min(s.w() - 2), (y as usize).min(s.h() - 2));
                let (a, b) = (x - i as f64, y - j as f64);
                let value = |di: usize, dj: usize| f64::from(self.source.at(n, c, j + dj, i + di));
                let (top, bottom) = ((1.0 - a) * value(0, 0) + a * value(1, 0), (1.0 - a) * value(0, 1) + a * value(1, 1));
                ((1.0 - b) * top + b * bottom) as f32
            })
        }
    }

    fn gap(a: &Se3, b: &Se3) -> f64 {
        (a.rotation - b.rotation).norm() + (a.translation - b.translation).norm()
    }

    #[test]
    fn the_network_sees_the_earlier_image_first() {
        let one = Setting::new(1);
        let other_way = Setting { target: one.source.clone(), source: one.target.clone(), ..Setting::new(1) };
        let (there, back) = (one.said(&one.pairs(0)), other_way.said(&other_way.pairs(N)));
        for (there, back) in there.iter().zip(&back) {
            assert!(gap(there, &Se3::identity()) > 1e-3, "a network that says nothing shows nothing: {there:?}");
            assert!(gap(&(*there * *back), &Se3::identity()) < 1e-5);
        }
        // A batch of both orders.
        let mixed = one.said(&one.pairs(1));
        assert!(gap(&mixed[0], &one.said(&one.pairs(N))[0]) < 1e-6);
        assert!(gap(&mixed[1], &there[1]) < 1e-6);
    }

    #[test]
    fn a_second_look_sees_the_warped_source_and_is_composed_with_the_first() {
        for earlier in [0, N] {
            let (once, twice) = (Setting::new(1), Setting::new(2));
            let first = once.said(&once.pairs(earlier));
            let warped = Setting { source: once.warped(&first), ..Setting::new(1) };
            let second = warped.said(&warped.pairs(earlier));
            for (n, got) in twice.said(&twice.pairs(earlier)).iter().enumerate() {
                let right = gap(got, &(first[n] * second[n]));
                assert!(right < 1e-4, "earlier {earlier}, sample {n}: {right}");
                for (other, what) in [(second[n] * first[n], "exchanged"), (first[n], "first"), (first[n] * first[n], "twice")] {
                    let wrong = gap(got, &other);
                    assert!(wrong > 1e-2, "the test could not tell: {what} looks differ by {wrong}");
                }
            }
        }
    }

    /// The gradient is that of the first look with the second held, plus that of the second with the first held.
    #[test]
    fn every_look_passes_its_gradient_and_the_warp_none() {
        let (once, twice) = (Setting::new(1), Setting::new(2));
        fn value<'t>(pose: Pose<'t, f32>) -> Var<'t, f32> {
            weighted_sum(pose.rotation, 11).add(weighted_sum(pose.translation, 12))
        }
        fn constant<'t>(tape: &'t Tape<f32>, motions: &[Se3]) -> Pose<'t, f32> {
            let (rotation, translation) = taped::pose::pose_tensors(motions);
            Pose { rotation: tape.constant(rotation), translation: tape.constant(translation) }
        }
        let gradients = |setting: &Setting, change: &dyn for<'t> Fn(Pose<'t, f32>) -> Var<'t, f32>| -> Vec<f32> {
            let tape = Tape::new();
            let mut binder = Binder::new(&tape, &setting.weights.pose, Mode::Eval);
            let pose = setting.model.source_from_target(&mut binder, &setting.pairs(0), setting.looks);
            let gradients = binder.gradients(&tape.backward(change(pose)));
            gradients.iter().flat_map(|g| g.gradient.to_vec()).collect()
        };
        let first = once.said(&once.pairs(0));
        let warped = Setting { source: once.warped(&first), ..Setting::new(1) };
        let second = warped.said(&warped.pairs(0));
        let whole = gradients(&twice, &|pose| value(pose));
        let of_first = gradients(&once, &|pose| value(pose.compose(constant(pose.rotation.tape(), &second))));
        let of_second = gradients(&warped, &|pose| value(constant(pose.rotation.tape(), &first).compose(pose)));
        let size = |x: &mut dyn Iterator<Item = f32>| x.map(|x| f64::from(x).powi(2)).sum::<f64>().sqrt();
        let parts = of_first.iter().zip(&of_second);
        let gap = size(&mut whole.iter().zip(parts).map(|(whole, (a, b))| whole - a - b));
        let smallest = size(&mut of_first.iter().copied()).min(size(&mut of_second.iter().copied()));
        assert!(gap < 1e-3 * smallest, "{gap} of {smallest}");
    }

    #[test]
    #[should_panic(expected = "a second look needs depth")]
    fn a_second_look_without_depth_is_refused() {
        let twice = Setting::new(2);
        twice.said(&Pairs { depth: None, ..twice.pairs(0) });
    }
}
