//! The three losses of DCPI-Depth in every form.

use dimode::losses::contextual_divergence::{DivergenceForm, divergence_agreement};
use dimode::losses::contextual_geometric::{
    ContextualForm, ContextualInputs, TriangulatedForm, radial_depth, triangulated_depth,
};
use dimode::losses::gated::Gated;
use dimode::losses::rigid_agreement::rigid_agreement;
use dimode_autodiff::{GradCheck, Scalar, Tape, Tensor, Var};
use dimode_geometry::Se3;
use dimode_geometry::taped::so3_exp;
use nalgebra::Vector3;

use crate::scenes::{bent, cameras, maps, motion, plane, seen, shifted, vectors};
use crate::support::{
    Loss, Scene, assert_finite, assert_gradient, assert_nothing, assert_order_free, assert_same_value, gradients, value,
};

const CHECK: GradCheck = GradCheck { step: 1e-7, atol: 1e-6, rtol: 1e-4, allow_zero: false };

/// Leaves are flow, depth, rotation vector and translation; data are the flows of the rotation and of the whole motion.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Contextual {
    Radial(ContextualForm),
    Triangulated(TriangulatedForm),
    Divergence(ContextualForm, DivergenceForm),
    Rigid,
}

const FORMS: [Contextual; 10] = [
    Contextual::Radial(ContextualForm::Corrected),
    Contextual::Radial(ContextualForm::ImageCentre),
    Contextual::Radial(ContextualForm::AsCoded),
    Contextual::Triangulated(TriangulatedForm::Corrected),
    Contextual::Triangulated(TriangulatedForm::AsCoded),
    Contextual::Divergence(ContextualForm::Corrected, DivergenceForm::Corrected),
    Contextual::Divergence(ContextualForm::ImageCentre, DivergenceForm::Corrected),
    Contextual::Divergence(ContextualForm::AsCoded, DivergenceForm::AsCoded),
    Contextual::Divergence(ContextualForm::Corrected, DivergenceForm::AsCoded),
    Contextual::Rigid,
];

impl Contextual {
    fn gated<'t, T: Scalar>(self, v: &[Var<'t, T>], scene: &Scene) -> Gated<'t, T> {
        let rotational = scene.data(0);
        let inputs = ContextualInputs {
            flow: v[0],
            depth: v[1],
            rotation: so3_exp(v[2]),
            translation: v[3],
            rotational: &rotational,
            intrinsics: &scene.cameras,
        };
        match self {
            Contextual::Radial(form) => radial_depth(&inputs, form),
            Contextual::Triangulated(form) => triangulated_depth(&inputs, form),
            Contextual::Divergence(centre, form) => divergence_agreement(&inputs, centre, form),
            Contextual::Rigid => rigid_agreement(v[0], &scene.data(1)),
        }
    }
}

impl Loss for Contextual {
    fn of<'t, T: Scalar>(&self, v: &[Var<'t, T>], scene: &Scene) -> Var<'t, T> {
        self.gated(v, scene).mean
    }
}

fn scene(motions: &[Se3]) -> Scene {
    let normals = vec![Vector3::new(0.2, -0.15, 1.0); motions.len()];
    let depth = plane(&normals, &[6.0, 5.0, 7.0][..motions.len()], &cameras());
    let [flow, _] = seen(&depth, motions, &cameras());
    let still: Vec<_> = motions.iter().map(|m| Se3 { translation: Vector3::zeros(), ..*m }).collect();
    let [rotational, _] = seen(&depth, &still, &cameras());
    let [w, t] = vectors(motions);
    Scene { leaves: vec![flow.clone(), depth, w, t], data: vec![rotational, flow], cameras: cameras() }
}

/// Three motions, mostly along the axis, with rotations.
fn general(sign: f64) -> Vec<Se3> {
    [[0.1, 0.12, 1.0], [0.15, 0.1, 0.8], [0.1, 0.2, 0.9]].map(|[x, y, z]| motion([0.01, 0.02, -0.01], [x, y, sign * z])).to_vec()
}

fn along_the_axis(z: f64) -> Vec<Se3> {
    vec![motion([0.0; 3], [0.0, 0.0, z]); 3]
}

fn noisy(sign: f64, seed: u64) -> Scene {
    let mut scene = scene(&general(sign));
    scene.leaves[0] = shifted(&scene.leaves[0], seed, 0.15);
    scene.leaves[1] = bent(&scene.leaves[1], seed + 1, 0.1);
    scene.leaves[3] = bent(&scene.leaves[3], seed + 2, 0.1);
    scene
}

/// Pixels without flow, with the opposite one, and with no depth.
fn hazardous(sign: f64, seed: u64) -> Scene {
    let rotational = noisy(sign, seed).data[0].clone();
    noisy(sign, seed)
        .with_leaf(0, |f, n, c, h, w| match (h, w) {
            (1, 1) => rotational.at(n, c, h, w),
            (2, 6) => -f,
            (4, 2) => 1e4,
            _ => f,
        })
        .with_leaf(1, |d, n, _, h, w| match (n, h, w) {
            (0, 4, 6) => 0.0,
            (1, 1, 4) => -2.0,
            (2, 3, 3) => 1e7,
            _ => d,
        })
}

#[test]
fn gradients_are_right_beside_hazards() {
    for (sign, seed) in [(-1.0, 10), (1.0, 20), (-1.0, 30)] {
        let scene = hazardous(sign, seed);
        for form in FORMS {
            // Which pixels a form with wrong signs keeps is chance: it may keep none.
            let check = GradCheck { allow_zero: matches!(form, Contextual::Divergence(..)), ..CHECK };
            assert_gradient(&form, &scene, check);
        }
    }
}

#[test]
fn numbers_are_finite_at_hazards() {
    let shape = maps(3).with_c(2);
    for scene in [
        scene(&general(-1.0)),
        scene(&general(1.0)),
        scene(&along_the_axis(-1.0)),
        scene(&vec![motion([0.0; 3], [0.4, 0.0, 0.0]); 3]),
        scene(&vec![motion([0.01, 0.0, 0.0], [0.0; 3]); 3]),
        scene(&along_the_axis(0.0)),
        hazardous(-1.0, 40),
        noisy(-1.0, 50).scaled(&[1], 0.0),
        noisy(-1.0, 60).with_data(0, Tensor::zeros(shape)),
        noisy(-1.0, 70).with_leaf(1, |d, _, _, h, w| if (h + w) % 4 == 0 { [f64::NAN, f64::INFINITY][h % 2] } else { d }),
        noisy(-1.0, 80).with_leaf(0, |f, _, c, h, w| if (h + w + c) % 4 == 0 { [f64::NAN, f64::INFINITY][h % 2] } else { f }),
        noisy(-1.0, 90).with_leaf(0, |f, _, _, h, w| if (h + w) % 4 == 0 { -1e-5 } else { f }),
    ] {
        for form in FORMS {
            assert_finite(&form, &scene);
        }
    }
}

#[test]
fn pixels_that_do_not_count_are_silent() {
    let scene = hazardous(-1.0, 100);
    for form in FORMS {
        // Differences over neighbours: every pixel may serve its neighbours.
        if matches!(form, Contextual::Divergence(..)) {
            continue;
        }
        let tape = Tape::<f64>::new();
        let v: Vec<_> = scene.leaves.iter().map(|x| tape.leaf(x.clone())).collect();
        let kept = form.gated(&v, &scene).kept;
        assert!(kept.data().contains(&0.0) && kept.data().contains(&1.0), "{form:?}");
        let (_, grads) = gradients::<f64>(&form, &scene);
        let s = grads[0].shape();
        for i in 0..s.len() {
            let [n, c, h, w] = s.unravel(i);
            let counts = kept.at(n, c.min(kept.shape().c() - 1), h, w) != 0.0;
            assert!(counts || grads[0].at(n, c, h, w) == 0.0, "{form:?}: flow at {:?}", [n, c, h, w]);
            let reads_depth = form != Contextual::Rigid;
            assert!(!reads_depth || counts || grads[1].at(n, 0, h, w) == 0.0, "{form:?}: depth at {:?}", [n, h, w]);
        }
    }
}

#[test]
fn nothing_counts_beyond_the_gates() {
    let scene = noisy(-1.0, 110).with_leaf(1, |_, _, _, _, _| -1.0);
    for form in [Contextual::Radial(ContextualForm::Corrected), Contextual::Triangulated(TriangulatedForm::Corrected)] {
        assert_nothing(&form, &scene);
    }
    assert_nothing(&Contextual::Rigid, &noisy(-1.0, 120).with_leaf(0, |_, _, _, _, _| 9.0));
    assert_nothing(&Contextual::Divergence(ContextualForm::Corrected, DivergenceForm::Corrected), &scene);
}

#[test]
fn the_truth_costs_what_the_guards_cost_for_either_source() {
    for z in [-1.0, 0.8] {
        // Radial depth is exact without rotation, along the axis; flow of 1e-5 px beside the guard.
        let axial = scene(&along_the_axis(z));
        let radial = value(&Contextual::Radial(ContextualForm::Corrected), &axial);
        // The pixel on the principal point has no radial flow: its depth is 0 and its error 1.
        let blind = 1.0 / (3.0 * 48.0);
        assert!((radial - blind).abs() < 2e-4, "{radial}");
        assert!(value(&Contextual::Rigid, &axial) < 1e-12);
        let any = scene(&general(z));
        let triangulated = value(&Contextual::Triangulated(TriangulatedForm::Corrected), &any);
        println!("z {z}: radial {radial:.2e} of which {blind:.2e} at the principal point; triangulated {triangulated:.2e}");
        assert!(triangulated < 5e-3, "{triangulated}");
        assert!(value(&Contextual::Rigid, &any) < 1e-12);
        let divergence = Contextual::Divergence(ContextualForm::Corrected, DivergenceForm::Corrected);
        let small = value(&divergence, &scene(&along_the_axis(0.02 * z)));
        assert!(small < 0.05, "{small}");
    }
}

#[test]
fn neither_the_order_nor_a_common_scale_matters() {
    let scene = noisy(-1.0, 130);
    for form in FORMS {
        assert_order_free(&form, &scene);
        if !matches!(form, Contextual::Rigid) {
            // The guards of 1e-5 are in units of depth.
            let (one, two) = (value(&form, &scene), value(&form, &scene.scaled(&[1, 3], 1.7)));
            assert!((one - two).abs() < 1e-4 * (1.0 + one), "{form:?}: {one} {two}");
        }
    }
    let exact = Contextual::Rigid;
    assert_same_value(&exact, &scene, &scene.scaled(&[1, 3], 1.7), 1e-15);
}
