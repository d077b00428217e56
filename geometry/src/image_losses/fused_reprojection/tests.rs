use dimode_autodiff::gradcheck::random;
use dimode_autodiff::ops::bilinear_sample::SamplePadding;
use dimode_autodiff::{GradCheck, Pool, Shape, Tape, Tensor, Var, gradcheck, par};
use nalgebra::Vector3;

use super::super::min_reprojection::{average_reprojection, min_reprojection};
use super::super::photometric::{photometric, photometric_value};
use super::*;
use crate::Se3;
use crate::taped::pose::pose_tensors;
use crate::taped::{rigid_flow, warp};

/// A batch with its depths and motions.
struct Scene {
    depth: Tensor<f64>,
    motions: [Tensor<f64>; 2],
    cameras: Vec<Intrinsics>,
    target: Tensor<f64>,
    sources: Tensor<f64>,
}

impl Scene {
    /// Two samples of two sources.
    fn new(seed: u64, h: usize, w: usize) -> Self {
        let (n, k) = (2, 2);
        let motions: Vec<Se3> = (0..n * k)
            .map(|i| {
                let part: Tensor<f64> = random(seed + 10 + i as u64, Shape::new(1, 6, 1, 1), -1.0, 1.0);
                let v = |from: usize, size: f64| size * Vector3::from_column_slice(&part.data()[from..from + 3]);
                Se3::from_rotation_vector(&v(0, 0.04), v(3, 0.5))
            })
            .collect();
        let (r, t) = pose_tensors(&motions);
        let (fu, fv) = (0.8 * w as f64, 0.9 * w as f64);
        let camera = Intrinsics::new(fu, fv, 0.45 * w as f64, 0.55 * h as f64, w, h).unwrap();
        Self {
            depth: random(seed, Shape::new(n, 1, h, w), 2.0, 9.0),
            motions: [r, t],
            cameras: vec![camera; n * k],
            target: random(seed + 1, Shape::new(n, 3, h, w), 0.0, 1.0),
            sources: random(seed + 2, Shape::new(k * n, 3, h, w), 0.0, 1.0),
        }
    }

    fn samples(&self) -> usize {
        self.depth.shape().n()
    }

    fn of_source(x: &Tensor<f64>, n: usize, k: usize) -> Tensor<f64> {
        let len = n * x.shape().c() * x.shape().plane();
        let s = x.shape();
        Tensor::from_vec(Shape::new(n, s.c(), s.h(), s.w()), x.data()[k * len..][..len].to_vec())
    }

    /// Errors of the sources that did not move.
    fn identities(&self) -> Vec<Tensor<f64>> {
        (0..2).map(|k| photometric_value(&Self::of_source(&self.sources, self.samples(), k), &self.target)).collect()
    }

    fn inputs(&self) -> Vec<Tensor<f64>> {
        vec![self.depth.clone(), self.motions[0].clone(), self.motions[1].clone()]
    }
}

/// A scene, its identities and how sources combine.
struct Case<'a> {
    scene: &'a Scene,
    identities: Vec<Tensor<f64>>,
    combine: Combine,
}

impl Case<'_> {
    fn composed<'t>(&self, v: &[Var<'t, f64>]) -> (Var<'t, f64>, f64) {
        let (tape, s) = (v[0].tape(), self.scene);
        let n = s.samples();
        let flow = rigid_flow(Var::concat(&[v[0], v[0]], 0), v[1], v[2], &s.cameras).slice(1, 0, 2);
        let warped = warp(tape.constant(s.sources.clone()), flow, SamplePadding::Border);
        let target = tape.constant(s.target.clone());
        let errors = [0, 1].map(|k| photometric(warped.slice(0, k * n, n), target));
        let best = match self.combine {
            Combine::Minimum => min_reprojection(&errors, &self.identities),
            Combine::Average => average_reprojection(&errors, &self.identities),
        };
        (best.error.mean(), best.share)
    }

    fn fused<'t>(&self, v: &[Var<'t, f64>]) -> (Var<'t, f64>, f64) {
        let s = self.scene;
        let frames = Frames::new(v[0].tape(), &s.target, &s.sources, &self.identities, self.combine);
        let found = fused_reprojection(v[0], Pose { rotation: v[1], translation: v[2] }, &s.cameras, &frames);
        (found.mean, found.share)
    }

    /// Value, share and the three gradients.
    fn run(&self, fused: bool) -> (f64, f64, Vec<Tensor<f64>>) {
        let tape = Tape::new();
        let v: Vec<_> = self.scene.inputs().into_iter().map(|x| tape.leaf(x)).collect();
        let (mean, share) = if fused { self.fused(&v) } else { self.composed(&v) };
        let grads = tape.backward(mean.scale(0.7));
        (mean.value().item(), share, v.iter().map(|&v| grads.wrt(v)).collect())
    }

    #[track_caller]
    fn assert_agrees(&self, what: &str) {
        let (mean, share, gradients) = self.run(false);
        let (fused_mean, fused_share, fused_gradients) = self.run(true);
        assert!((mean - fused_mean).abs() < 1e-12, "{what}: {mean} and {fused_mean}");
        assert!((share - fused_share).abs() < 1e-12, "{what}: share {share} and {fused_share}");
        for (i, (a, b)) in gradients.iter().zip(&fused_gradients).enumerate() {
            for (j, (a, b)) in a.data().iter().zip(b.data()).enumerate() {
                assert!((a - b).abs() < 1e-10 * (1.0 + a.abs()), "{what}: gradient {i} at {j}: {a} and {b}");
            }
        }
    }
}

fn cases(scene: &Scene) -> [Case<'_>; 4] {
    [(Combine::Minimum, true), (Combine::Minimum, false), (Combine::Average, true), (Combine::Average, false)]
        .map(|(combine, masked)| Case { scene, identities: if masked { scene.identities() } else { Vec::new() }, combine })
}

#[test]
fn equals_the_composed_form_at_any_size() {
    for (i, (h, w)) in
        [(2, 2), (2, 5), (5, 2), (3, 3), (4, 7), (33, 17), (32, 16), (65, 33), (66, 40), (31, 70)].into_iter().enumerate()
    {
        let scene = Scene::new(100 * i as u64, h, w);
        for (j, case) in cases(&scene).iter().enumerate() {
            case.assert_agrees(&format!("{h}x{w}, case {j}"));
        }
    }
}

#[test]
fn gradients_match_central_differences() {
    for (seed, h, w) in [(5, 2, 3), (6, 5, 7), (7, 34, 3)] {
        let scene = Scene::new(seed, h, w);
        for (j, case) in cases(&scene).iter().enumerate() {
            let check = GradCheck { step: 1e-7, rtol: 1e-4, atol: 1e-7, ..GradCheck::default() };
            let report = gradcheck(&scene.inputs(), |_, v| case.fused(v).0, check);
            assert!(report.is_ok(), "{h}x{w}, case {j}: {report}");
        }
    }
}
