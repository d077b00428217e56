//! Photometric error, minimum over sources, smoothness, their total over scales, and the anchor of the scale.

use dimode::losses::min_reprojection::{average_reprojection, min_reprojection};
use dimode::losses::multi_scale::{MultiScale, Reprojection, SMOOTHNESS, multi_scale};
use dimode::losses::photometric::{absolute_difference, photometric, photometric_value};
use dimode::losses::scale_anchor::scale_anchor;
use dimode::losses::smoothness::{edge_aware, edge_aware_of_both, smoothness};
use dimode::losses::ssim::{Border, dissimilarity};
use dimode::model::DepthRange;
use dimode_autodiff::gradcheck::random;
use dimode_autodiff::ops::bilinear_sample::SamplePadding;
use dimode_autodiff::{GradCheck, Scalar, Shape, Tape, Tensor, Var};
use dimode_geometry::taped::{Pose, rigid_flow, so3_exp, warp};

use crate::scenes::{H, W, bent, cameras, facing_the_source, images, maps, motion, motions, seen, vectors};
use crate::support::{Loss, Scene, assert_finite, assert_gradient, assert_order_free, assert_same_value, gradients, value};

const CHECK: GradCheck = GradCheck { step: 1e-6, rtol: 1e-5, atol: 1e-8, allow_zero: false };

/// Of two images.
#[derive(Clone, Copy, Debug)]
enum Images {
    Photometric,
    Absolute,
    Dissimilarity(usize, Border),
}

const IMAGES: [Images; 5] = [
    Images::Photometric,
    Images::Absolute,
    Images::Dissimilarity(3, Border::Mirrored),
    Images::Dissimilarity(7, Border::Mirrored),
    Images::Dissimilarity(3, Border::LeftOut),
];

impl Loss for Images {
    fn of<'t, T: Scalar>(&self, v: &[Var<'t, T>], _: &Scene) -> Var<'t, T> {
        match *self {
            Images::Photometric => photometric(v[0], v[1]),
            Images::Absolute => absolute_difference(v[0], v[1]),
            Images::Dissimilarity(window, border) => dissimilarity(v[0], v[1], window, border),
        }
        .mean()
    }
}

fn two_images(seed: u64) -> Scene {
    Scene { leaves: vec![images(3, seed), images(3, seed + 1)], data: vec![], cameras: vec![] }
}

#[test]
fn gradients_of_image_errors_are_right_beside_flat_and_opposite_images() {
    for seed in [10, 20] {
        let flat = two_images(seed).with_leaf(0, |x, n, _, _, w| if n == 1 && w > 2 { 0.4 } else { x });
        let flat = flat.with_leaf(1, |x, n, _, _, w| if n == 1 && w > 2 { 0.47 } else { x });
        let opposite = two_images(seed);
        let negative = opposite.leaves[0].clone();
        let opposite = opposite.with_leaf(1, |x, n, c, h, w| if n == 2 { 1.0 - negative.at(n, c, h, w) } else { x });
        for form in IMAGES {
            assert_gradient(&form, &two_images(seed), CHECK);
            assert_gradient(&form, &flat, CHECK);
            assert_gradient(&form, &opposite, CHECK);
        }
    }
}

#[test]
fn image_errors_are_finite_at_equal_flat_and_black_images() {
    for scene in [
        Scene { leaves: vec![images(3, 30), images(3, 30)], ..two_images(30) },
        two_images(30).scaled(&[0, 1], 0.0),
        two_images(30).scaled(&[0], 0.0),
        two_images(30).with_leaf(0, |_, _, _, _, _| 1.0),
        two_images(30).with_leaf(0, |_, _, _, _, _| 0.5).with_leaf(1, |_, _, _, _, _| 0.5),
    ] {
        for form in IMAGES {
            assert_finite(&form, &scene);
        }
    }
    for form in IMAGES {
        let equal = Scene { leaves: vec![images(3, 30), images(3, 30)], ..two_images(30) };
        assert!(value(&form, &equal).abs() < 1e-14, "{form:?}");
        assert_order_free(&form, &two_images(40));
    }
}

/// Of error maps; data are maps of unmoved sources.
#[derive(Clone, Copy, Debug)]
enum Choice {
    Minimum,
    Average,
    /// Without unmoved sources.
    Unmasked,
}

impl Loss for Choice {
    fn of<'t, T: Scalar>(&self, v: &[Var<'t, T>], scene: &Scene) -> Var<'t, T> {
        let identities = [scene.data(0), scene.data(1)];
        match self {
            Choice::Minimum => min_reprojection(v, &identities),
            Choice::Average => average_reprojection(v, &identities),
            Choice::Unmasked => min_reprojection(v, &[]),
        }
        .error
        .mean()
    }
}

const CHOICES: [Choice; 3] = [Choice::Minimum, Choice::Average, Choice::Unmasked];

fn error_maps(seed: u64) -> Scene {
    let errors = |k| random::<f64>(seed + k, maps(3), 0.0, 1.0);
    Scene { leaves: vec![errors(0), errors(1)], data: vec![errors(2), errors(3)], cameras: vec![] }
}

#[test]
fn the_winner_alone_has_a_gradient() {
    for choice in CHOICES {
        assert_gradient(&choice, &error_maps(50), CHECK);
        assert_order_free(&choice, &error_maps(50));
        // Equal errors everywhere, and sources that are hopeless.
        assert_finite(&choice, &error_maps(60).scaled(&[0, 1], 0.0));
        assert_finite(&choice, &error_maps(60).with_leaf(0, |_, _, _, _, _| 1e30));
    }
    let scene = error_maps(70);
    let (_, grads) = gradients::<f64>(&Choice::Minimum, &scene);
    let maps = [&scene.data[0], &scene.data[1], &scene.leaves[0], &scene.leaves[1]];
    for i in 0..3 * H * W {
        let least = (0..4).min_by(|&a, &b| maps[a].data()[i].total_cmp(&maps[b].data()[i])).expect("four maps");
        let share = 1.0 / (3 * H * W) as f64;
        let expected = [0, 1].map(|k| if least == k + 2 { share } else { 0.0 });
        assert_eq!([0, 1].map(|k| grads[k].data()[i]), expected, "pixel {i}: {least} wins");
    }
}

/// Of a disparity and an image.
#[derive(Clone, Copy, Debug)]
enum Smooth {
    Normalised,
    Raw,
    OfBoth,
    Anchor,
}

impl Loss for Smooth {
    fn of<'t, T: Scalar>(&self, v: &[Var<'t, T>], scene: &Scene) -> Var<'t, T> {
        match self {
            Smooth::Normalised => smoothness(v[0], &scene.data(0)),
            Smooth::Raw => edge_aware(v[0], &scene.data(0), 3.0),
            Smooth::OfBoth => edge_aware_of_both(v[0], v[1], 2.0),
            Smooth::Anchor => scale_anchor(v[0], 0.2),
        }
    }
}

const SMOOTH: [Smooth; 4] = [Smooth::Normalised, Smooth::Raw, Smooth::OfBoth, Smooth::Anchor];

fn disparities(seed: u64) -> Scene {
    Scene {
        leaves: vec![random(seed, maps(3), 0.05, 0.9), images(3, seed + 1)],
        data: vec![images(3, seed + 2)],
        cameras: vec![],
    }
}

#[test]
fn smoothness_and_anchor_obey_the_laws() {
    for form in SMOOTH {
        for seed in [80, 90] {
            assert_gradient(&form, &disparities(seed), CHECK);
        }
        assert_finite(&form, &disparities(80).with_leaf(0, |_, _, _, _, _| 0.3));
        assert_finite(&form, &disparities(80).with_leaf(0, |_, _, _, _, _| 0.2).with_leaf(1, |_, _, _, _, _| 0.5));
        assert_finite(&form, &disparities(80).with_leaf(0, |x, n, _, _, _| if n == 1 { 1e-6 } else { x }));
        if matches!(form, Smooth::Anchor) {
            // A logarithm of a mean over the batch: rounding depends on the order.
            let (one, other) = (disparities(80), disparities(80).reversed());
            assert_same_value(&form, &one, &other, 1e-13);
        } else {
            assert_order_free(&form, &disparities(80));
        }
    }
    assert_finite(&Smooth::Normalised, &disparities(80).scaled(&[0], 0.0));
    // The guard of the normalisation is 1e-7.
    assert_same_value(&Smooth::Normalised, &disparities(80), &disparities(80).scaled(&[0], 7.0), 1e-5);
}

/// Leaves are disparities at two scales and two motions; data are the target at both scales and the sources.
#[derive(Clone, Copy, Debug)]
struct Total {
    reprojection: Reprojection,
    auto_mask: bool,
}

impl Loss for Total {
    fn of<'t, T: Scalar>(&self, v: &[Var<'t, T>], scene: &Scene) -> Var<'t, T> {
        let targets = [scene.data(0), scene.data(1)];
        let sources = [scene.data(2), scene.data(3)];
        let identities: Vec<_> = sources.iter().filter(|_| self.auto_mask).map(|s| photometric_value(s, &targets[0])).collect();
        let pose = |k: usize| Pose { rotation: so3_exp(v[k]), translation: v[k + 1] };
        multi_scale(&MultiScale {
            disparities: &v[..2],
            range: DepthRange::MONODEPTH,
            targets: &targets,
            sources: &sources,
            motions: &[pose(2), pose(4)],
            intrinsics: &scene.cameras,
            identities: &identities,
            smoothness: SMOOTHNESS,
            reprojection: self.reprojection,
        })
        .total
    }
}

fn totals() -> impl Iterator<Item = Total> {
    [Reprojection::RigidFlow, Reprojection::AsCoded]
        .into_iter()
        .flat_map(|reprojection| [true, false].map(|auto_mask| Total { reprojection, auto_mask }))
}

fn snippet(seed: u64) -> Scene {
    let half = Shape::new(3, 1, H / 2, W / 2);
    let small = random(seed + 9, half.with_c(3), 0.0, 1.0);
    let [[w1, t1], [w2, t2]] = [vectors(&motions(-1.0)), vectors(&motions(1.0))];
    // Depths about 2 to 7.
    let leaves = vec![random(seed, maps(3), 0.013, 0.05), random(seed + 1, half, 0.013, 0.05), w1, t1, w2, t2];
    let data = vec![images(3, seed + 2), small, images(3, seed + 3), images(3, seed + 4)];
    Scene { leaves, data, cameras: cameras() }
}

#[test]
fn totals_have_right_gradients_beside_points_that_the_camera_passes() {
    for seed in [100, 110] {
        let passing = snippet(seed).with_leaf(0, |x, n, _, h, w| if (n, h, w) == (1, 3, 4) { 0.4 } else { x });
        for loss in totals() {
            assert_gradient(&loss, &passing, GradCheck { step: 1e-7, rtol: 1e-4, atol: 1e-6, allow_zero: false });
        }
    }
}

#[test]
fn totals_are_finite_at_hazards() {
    let still = vectors(&vec![motion([0.0; 3], [0.0; 3]); 3]);
    let put = |scene: Scene, k: usize, x: &Tensor<f64>| scene.with_leaf(k, |_, n, c, _, _| x.at(n, c, 0, 0));
    let resting = (2..6).fold(snippet(120), |s, k| put(s, k, &still[k % 2]));
    let equal = resting.clone().with_data(2, resting.data[0].clone()).with_data(3, resting.data[0].clone());
    for scene in [
        resting,
        equal,
        snippet(120).scaled(&[0, 1], 20.0),
        snippet(120).scaled(&[0, 1], 0.0),
        snippet(120).scaled(&[3, 5], 100.0),
        snippet(120).scaled(&[3, 5], -100.0),
    ] {
        for loss in totals() {
            assert_finite(&loss, &scene);
        }
    }
}

#[test]
fn totals_do_not_depend_on_the_order() {
    for loss in totals() {
        assert_order_free(&loss, &snippet(130));
    }
}

/// The photometric error of a source read by rigid flow: depth, rotation vector and translation are leaves.
#[derive(Debug)]
struct Warped;

impl Loss for Warped {
    fn of<'t, T: Scalar>(&self, v: &[Var<'t, T>], scene: &Scene) -> Var<'t, T> {
        let flow = rigid_flow(v[0], so3_exp(v[1]), v[2], &scene.cameras).slice(1, 0, 2);
        let tape = flow.tape();
        let source = warp(tape.constant(scene.data(1)), flow, SamplePadding::Border);
        photometric(source, tape.constant(scene.data(0))).mean()
    }
}

#[test]
fn a_common_scale_of_depth_and_translation_does_not_matter() {
    let motions = motions(-1.0);
    let [w, t] = vectors(&motions);
    let depth = bent(&facing_the_source(6.0, &motions, &cameras()), 1, 0.2);
    let scene = Scene { leaves: vec![depth, w, t], data: vec![images(3, 2), images(3, 3)], cameras: cameras() };
    for factor in [0.3, 4.0] {
        assert_same_value(&Warped, &scene, &scene.scaled(&[0, 2], factor), 1e-12);
    }
    assert_order_free(&Warped, &scene);
}

#[test]
fn the_truth_of_a_linear_texture_costs_nothing_in_view() {
    // A wall that faces both cameras with colours linear along it: reading between pixels is exact.
    let motions: Vec<_> = [[0.4, 0.2, -0.8], [0.3, -0.3, -0.7], [-0.2, 0.2, -0.9]].map(|t| motion([0.0; 3], t)).to_vec();
    let depth = facing_the_source(5.0, &motions, &cameras());
    let [flow, _] = seen(&depth, &motions, &cameras());
    let k = cameras();
    let colour = |n: usize, c: usize, u: f64, v: f64, z: f64, x: f64, y: f64| {
        let ray = k[n].ray(u, v) * z;
        0.5 + 0.03 * (ray.x - x) * (1.0 + c as f64) - 0.05 * (ray.y - y)
    };
    let target =
        Tensor::from_fn(maps(3).with_c(3), |n, c, h, w| colour(n, c, w as f64, h as f64, depth.at(n, 0, h, w), 0.0, 0.0));
    let source = Tensor::from_fn(maps(3).with_c(3), |n, c, h, w| {
        let t = motions[n].translation;
        colour(n, c, w as f64, h as f64, 5.0, t.x, t.y)
    });
    let tape = Tape::<f64>::new();
    let read = warp(tape.constant(source), tape.constant(flow.clone()), SamplePadding::Border).value();
    let view = dimode_geometry::taped::masks::in_view(&flow);
    let mut inside = 0;
    for n in 0..3 {
        for i in (0..H * W).filter(|&i| view.plane(n, 0)[i] != 0.0) {
            inside += 1;
            assert!((0..3).all(|c| (read.plane(n, c)[i] - target.plane(n, c)[i]).abs() < 1e-14));
        }
    }
    assert!(inside > 60, "{inside}");
}
