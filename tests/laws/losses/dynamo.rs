//! The four terms of Dynamo-Depth, of flows in space.

use dimode::losses::dynamo::{MotionTerms, MotionWeights, consistency, flow_smoothness, mask_smoothness, scene_flow, sparsity};
use dimode_autodiff::gradcheck::{random, weighted_sum};
use dimode_autodiff::{GradCheck, Scalar, Tensor, Var};
use dimode_geometry::taped::{Pose, so3_exp};

use crate::scenes::{bent, cameras, facing_the_source, images, maps, mask, motion, motions, vectors};
use crate::support::{Loss, Scene, assert_finite, assert_gradient, assert_nothing, assert_order_free, assert_silent, value};

const CHECK: GradCheck = GradCheck { step: 1e-7, atol: 1e-7, rtol: 1e-5, allow_zero: false };

/// Leaves are depth, rotation vector, translation, complete flow and the mask's logit; data are images, disparity,
/// static pixels and the mask that has no gradient.
#[derive(Clone, Copy, Debug)]
enum Dynamo {
    Consistency,
    Sparsity,
    MaskSmoothness,
    FlowSmoothness,
    /// All of them with their weights.
    Total,
    /// Every entry of the flow in the image that moving things have.
    ImageFlow,
}

const FORMS: [Dynamo; 6] =
    [Dynamo::Consistency, Dynamo::Sparsity, Dynamo::MaskSmoothness, Dynamo::FlowSmoothness, Dynamo::Total, Dynamo::ImageFlow];

impl Loss for Dynamo {
    fn of<'t, T: Scalar>(&self, v: &[Var<'t, T>], scene: &Scene) -> Var<'t, T> {
        let pose = Pose { rotation: so3_exp(v[1]), translation: v[2] };
        let moving = v[4].sigmoid();
        let parts = scene_flow(v[0], pose, v[3], moving, &scene.cameras);
        let (image, disparity, still) = (scene.data(0), scene.data(1), scene.data(2));
        let terms = || MotionTerms {
            consistency: consistency(parts.residual, &scene.data(3), &disparity),
            sparsity: sparsity(v[4], &still),
            mask_smoothness: mask_smoothness(moving, &image),
            flow_smoothness: flow_smoothness(v[3], &image),
        };
        match self {
            Dynamo::Consistency => terms().consistency,
            Dynamo::Sparsity => terms().sparsity,
            Dynamo::MaskSmoothness => terms().mask_smoothness,
            Dynamo::FlowSmoothness => terms().flow_smoothness,
            Dynamo::Total => terms().weighted(&MotionWeights::default(), 0.5, 1, 2),
            Dynamo::ImageFlow => weighted_sum(parts.image_flow(pose, &scene.cameras).slice(1, 0, 2), 5),
        }
    }
}

fn scene(seed: u64) -> Scene {
    let motions = motions(-1.0);
    let depth = bent(&facing_the_source(6.0, &motions, &cameras()), seed, 0.1);
    let [w, t] = vectors(&motions);
    let leaves = vec![depth, w, t, random(seed + 1, maps(3).with_c(3), -0.5, 0.5), random(seed + 2, maps(3), -2.0, 2.0)];
    // Nothing of the last image is near, or static.
    let disparity = Tensor::from_fn(maps(3), |n, _, h, w| if n == 2 || (h + w) % 5 == 0 { 0.01 } else { 0.2 });
    let still = mask(3, |n, h, w| n < 2 && (h * w) % 3 != 1);
    let data = vec![images(3, seed + 3), disparity, still, random(seed + 4, maps(3), 0.1, 0.9)];
    Scene { leaves, data, cameras: cameras() }
}

/// Where the camera passes points.
fn passing(seed: u64) -> Scene {
    let here = |n: usize, h: usize| n == 1 && h == 2;
    // Hardly anything moves by itself there, or a point might lie right in the plane of the camera.
    scene(seed)
        .with_leaf(0, |d, n, _, h, _| if here(n, h) { 0.1 } else { d })
        .with_leaf(4, |x, n, _, h, _| if here(n, h) { -3.0 } else { x })
}

#[test]
fn gradients_are_right_beside_hazards() {
    for seed in [10, 20, 30] {
        for form in FORMS {
            assert_gradient(&form, &passing(seed), CHECK);
        }
    }
}

#[test]
fn numbers_are_finite_without_motion_pixels_or_residual() {
    let still = vectors(&vec![motion([0.0; 3], [0.0; 3]); 3]);
    let set = |scene: Scene, k: usize, x: &Tensor<f64>| scene.with_leaf(k, |_, n, c, h, w| x.at(n, c, h, w));
    let resting = set(set(scene(40), 1, &still[0]), 2, &still[1]).scaled(&[3], 0.0);
    let none = Tensor::zeros(maps(3));
    for scene in [
        resting.clone(),
        passing(50),
        scene(60).scaled(&[0], 0.0),
        scene(60).scaled(&[0], -1.0),
        scene(60).scaled(&[4], 1e3),
        scene(60).with_data(1, none.clone()).with_data(2, none.clone()),
    ] {
        for form in FORMS {
            assert_finite(&form, &scene);
        }
    }
    assert_nothing(&Dynamo::Consistency, &resting);
    assert_nothing(&Dynamo::Consistency, &scene(60).with_data(1, none.clone()));
    assert_nothing(&Dynamo::Sparsity, &scene(60).with_data(2, none));
}

/// Of a residual and logits alone.
#[derive(Clone, Copy, Debug)]
enum Direct {
    Consistency,
    Sparsity,
}

impl Loss for Direct {
    fn of<'t, T: Scalar>(&self, v: &[Var<'t, T>], scene: &Scene) -> Var<'t, T> {
        match self {
            Direct::Consistency => consistency(v[0], &scene.data(2), &scene.data(1)),
            Direct::Sparsity => sparsity(v[0], &scene.data(2)),
        }
    }
}

#[test]
fn far_moving_and_not_static_pixels_are_silent_whatever_stands_there() {
    let scene = scene(70);
    let near = crate::support::map(&scene.data[1], |d| f64::from(u8::from(d > 0.03)));
    let moves = mask(3, |_, h, w| (h + 2 * w) % 4 == 1);
    let used = Tensor::from_vec(maps(3), near.data().iter().zip(moves.data()).map(|(n, m)| n * (1.0 - m)).collect());
    let residual = Scene { leaves: vec![scene.leaves[3].clone()], ..scene.clone() }.with_data(2, moves);
    assert_silent(&Direct::Consistency, &residual, &[Some(used)]);
    let logits = Scene { leaves: vec![scene.leaves[4].clone()], ..scene.clone() };
    assert_silent(&Direct::Sparsity, &logits, &[Some(scene.data[2].clone())]);
}

#[test]
fn the_truth_of_a_static_scene_costs_nothing() {
    // The complete flow is that of the camera, computed by the plain geometry.
    let (scene, motions, k) = (scene(80), motions(-1.0), cameras());
    let truth = scene.clone().with_leaf(3, |_, n, c, h, w| {
        let point = k[n].ray(w as f64, h as f64) * scene.leaves[0].at(n, 0, h, w);
        (motions[n].rotation * point + motions[n].translation - point)[c]
    });
    assert!(value(&Dynamo::Consistency, &truth) < 1e-14);
    assert!(value(&Dynamo::Consistency, &scene) > 1e-2);
}

#[test]
fn the_order_does_not_matter_and_lengths_scale_what_is_measured_in_them() {
    let scene = scene(90);
    for form in FORMS {
        // Its weights belong to places in the batch.
        if !matches!(form, Dynamo::ImageFlow) {
            assert_order_free(&form, &scene);
        }
    }
    let scaled = scene.scaled(&[0, 2, 3], 2.5);
    for (form, power) in
        [(Dynamo::Consistency, 1), (Dynamo::Sparsity, 0), (Dynamo::MaskSmoothness, 0), (Dynamo::FlowSmoothness, 1)]
    {
        let (one, two) = (value(&form, &scene), value(&form, &scaled));
        assert!((two - 2.5_f64.powi(power) * one).abs() < 1e-12, "{form:?}: {one} {two}");
    }
}
