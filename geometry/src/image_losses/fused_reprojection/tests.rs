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
    /// Of each source.
    sources: [Tensor<f64>; 2],
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
            sources: [2, 3].map(|k| random(seed + k, Shape::new(n, 3, h, w), 0.0, 1.0)),
        }
    }

    fn samples(&self) -> usize {
        self.depth.shape().n()
    }

    /// Errors of the sources that did not move.
    fn identities(&self) -> Vec<Tensor<f64>> {
        self.sources.iter().map(|source| photometric_value(source, &self.target)).collect()
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
        let target = tape.constant(s.target.clone());
        let errors = [0, 1].map(|k| {
            let source = tape.constant(s.sources[k].clone());
            photometric(warp(source, flow.slice(0, k * n, n), SamplePadding::Border), target)
        });
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

impl Scene {
    /// All motions have this translation and rotation vector.
    fn moved(mut self, turn: [f64; 3], by: [f64; 3]) -> Self {
        let motion = Se3::from_rotation_vector(&Vector3::from(turn), Vector3::from(by));
        self.motions = pose_tensors(&vec![motion; self.cameras.len()]).into();
        self
    }
}

#[test]
fn points_behind_the_source_and_out_of_view_are_those_of_the_composed_form() {
    for (turn, by) in [
        ([0.0; 3], [0.3, 0.1, -5.0]),
        ([0.0, 0.5, 0.0], [3.0, 0.0, 0.5]),
        ([0.4, 0.0, 0.2], [0.0, -4.0, 0.0]),
        ([0.0; 3], [0.0, 0.0, -50.0]),
    ] {
        let scene = Scene::new(3, 19, 21).moved(turn, by);
        for (j, case) in cases(&scene).iter().enumerate() {
            case.assert_agrees(&format!("{by:?}, case {j}"));
        }
    }
}

#[test]
fn a_source_that_did_not_move_ties_with_its_identity_and_loses() {
    let scene = Scene::new(4, 35, 20).moved([0.0; 3], [0.0; 3]);
    let case = Case { scene: &scene, identities: scene.identities(), combine: Combine::Minimum };
    case.assert_agrees("no motion");
    let (_, share, gradients) = case.run(true);
    assert_eq!(share, 0.0);
    assert!(gradients.iter().all(|g| g.data().iter().all(|&g| g == 0.0)));
}

#[test]
fn a_depth_that_is_no_number_shows_and_does_not_spread() {
    let (h, w, at) = (11, 40, [5, 20]);
    let clean = Scene::new(5, h, w);
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let depth = Tensor::from_fn(clean.depth.shape(), |n, c, v, u| match [v, u] == at {
            true => bad,
            false => clean.depth.at(n, c, v, u),
        });
        let scene = Scene { depth, ..Scene::new(5, h, w) };
        for (case, clean) in cases(&scene).iter().zip(cases(&clean)) {
            let (mean, _, gradients) = case.run(true);
            assert_eq!(mean.is_nan(), case.run(false).0.is_nan());
            assert!(gradients.iter().all(|g| g.data().iter().all(|g| g.is_finite())));
            let expected = &clean.run(true).2[0];
            for (v, u) in (0..h).flat_map(|v| (0..w).map(move |u| (v, u))) {
                let found = gradients[0].at(0, 0, v, u);
                if [v, u] == at {
                    assert_eq!(found, 0.0);
                } else if v.abs_diff(at[0]).max(u.abs_diff(at[1])) > 2 {
                    assert_eq!(found, expected.at(0, 0, v, u), "({v}, {u})");
                }
            }
        }
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bits_and_single_precision_is_near() {
    let scene = Scene::new(6, 67, 45);
    let single = |x: &Tensor<f64>| Tensor::from_vec(x.shape(), x.data().iter().map(|&x| x as f32).collect());
    let [depth, r, t] = [&scene.depth, &scene.motions[0], &scene.motions[1]].map(single);
    let (target, sources) = (single(&scene.target), scene.sources.each_ref().map(single));
    let identities: Vec<_> = scene.identities().iter().map(single).collect();
    let run = |threads| {
        par::with_threads(threads, || {
            let tape = Tape::<f32>::new();
            let frames = Frames::new(&tape, &target, &sources, &identities, Combine::Minimum);
            let v = [&depth, &r, &t].map(|x| tape.leaf(x.clone()));
            let found = fused_reprojection(v[0], Pose { rotation: v[1], translation: v[2] }, &scene.cameras, &frames);
            let grads = tape.backward(found.mean);
            let bits = v.map(|v| grads.wrt(v).data().iter().map(|x| x.to_bits()).collect::<Vec<_>>());
            (found.mean.value().item(), found.share, bits)
        })
    };
    let one = run(1);
    assert!((2..=4).all(|threads| run(threads) == one));
    let case = Case { scene: &scene, identities: scene.identities(), combine: Combine::Minimum };
    let (mean, share, _) = case.run(false);
    assert!((f64::from(one.0) / mean - 1.0).abs() < 1e-5 && (one.1 - share).abs() < 1e-3);
}

#[test]
fn constants_get_no_gradient_and_have_the_same_value() {
    let scene = Scene::new(7, 34, 20);
    for case in cases(&scene) {
        let tape = Tape::new();
        let leaves: Vec<_> = scene.inputs().into_iter().map(|x| tape.leaf(x)).collect();
        let constants: Vec<_> = scene.inputs().into_iter().map(|x| tape.constant(x)).collect();
        let (found, expected) = (case.fused(&constants), case.fused(&leaves));
        assert_eq!((found.0.value().item(), found.1), (expected.0.value().item(), expected.1));
        // One of three.
        let only_depth = [leaves[0], constants[1], constants[2]];
        let all = tape.backward(expected.0).wrt(leaves[0]);
        assert_eq!(tape.backward(case.fused(&only_depth).0).wrt(leaves[0]).data(), all.data());
    }
}

#[test]
fn buffers_come_from_the_pool_and_go_back() {
    let scene = Scene::new(8, 40, 64);
    let pool = Pool::new();
    let step = || {
        let tape = Tape::with_pool(pool.clone());
        let case = Case { scene: &scene, identities: Vec::new(), combine: Combine::Minimum };
        let v: Vec<_> = scene.inputs().into_iter().map(|x| tape.leaf(x)).collect();
        tape.backward(case.fused(&v).0);
    };
    par::with_threads(1, || {
        step();
        let elements = pool.elements();
        step();
        assert_eq!(pool.elements(), elements);
    });
}

#[test]
#[should_panic(expected = "must have equal shapes")]
fn rejects_sources_of_another_size() {
    let image = |h| Tensor::<f64>::full(Shape::new(1, 3, h, 4), 0.5);
    Frames::new(&Tape::new(), &image(4), &[image(5)], &[], Combine::Minimum);
}
