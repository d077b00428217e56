//! Cross-task consistency, in DF-Net's form and in that of the warm-up, also through the rigid flow.

use dimode::losses::cross_task::{FlowPair, cross_task, cross_task_of_scales};
use dimode::losses::flow_consistency::flow_consistency;
use dimode_autodiff::{GradCheck, Scalar, Tensor, Var};
use dimode_geometry::Se3;
use dimode_geometry::taped::{rigid_flow, so3_exp};

use crate::scenes::{bent, cameras, facing_the_source, maps, mask, motions, seen, shifted, vectors};
use crate::support::{
    Loss, Scene, assert_finite, assert_gradient, assert_nothing, assert_order_free, assert_same_value, assert_silent, value,
};

const CHECK: GradCheck = GradCheck { step: 1e-7, atol: 1e-7, rtol: 1e-6, allow_zero: false };

/// Of two flows, data is the mask.
#[derive(Clone, Copy, Debug)]
enum Direct {
    /// Rigid and optical flow are leaves.
    Both,
    /// The optical flow is the first of the data after the mask.
    Rigid,
}

impl Loss for Direct {
    fn of<'t, T: Scalar>(&self, v: &[Var<'t, T>], scene: &Scene) -> Var<'t, T> {
        match self {
            Direct::Both => cross_task(v[0], v[1], &scene.data(0)),
            Direct::Rigid => flow_consistency(v[0], &scene.data(1), &scene.data(0)),
        }
    }
}

/// Depth, rotation vector, translation and optical flow.
#[derive(Clone, Copy, Debug)]
struct Through(Direct);

impl Loss for Through {
    fn of<'t, T: Scalar>(&self, v: &[Var<'t, T>], scene: &Scene) -> Var<'t, T> {
        let rigid = rigid_flow(v[0], so3_exp(v[1]), v[2], &scene.cameras).slice(1, 0, 2);
        match self.0 {
            Direct::Both => cross_task(rigid, v[3], &scene.data(0)),
            Direct::Rigid => flow_consistency(rigid, &v[3].value(), &scene.data(0)),
        }
    }
}

/// Rigid and optical flow and both back at two scales; the masks are their own.
#[derive(Debug)]
struct Scales;

impl Loss for Scales {
    fn of<'t, T: Scalar>(&self, v: &[Var<'t, T>], _: &Scene) -> Var<'t, T> {
        let at = |k: usize| FlowPair { rigid: v[k], optical: v[k + 1], rigid_back: v[k + 2], optical_back: v[k + 3] };
        cross_task_of_scales(&[at(0), at(4)])
    }
}

/// All but some pixels of two images and nothing of a third.
fn used() -> Tensor<f64> {
    mask(3, |n, h, w| n < 2 && (h * w) % 4 != 2)
}

fn depth(motions: &[Se3]) -> Tensor<f64> {
    facing_the_source(6.0, motions, &cameras())
}

fn scene(sign: f64, size: f64) -> Scene {
    let motions = motions(sign);
    let [flow, _] = seen(&depth(&motions), &motions, &cameras());
    let [w, t] = vectors(&motions);
    let leaves = vec![bent(&depth(&motions), 1, size), bent(&w, 2, size), bent(&t, 3, size), shifted(&flow, 4, size)];
    Scene { leaves, data: vec![used()], cameras: cameras() }
}

fn direct(size: f64) -> Scene {
    let [rigid, _] = seen(&depth(&motions(-1.0)), &motions(-1.0), &cameras());
    let optical = shifted(&rigid, 5, size);
    Scene { leaves: vec![rigid, optical.clone()], data: vec![used(), optical], cameras: cameras() }
}

/// The first leaf alone.
fn rigid_only(scene: Scene) -> Scene {
    Scene { leaves: vec![scene.leaves[0].clone()], ..scene }
}

fn scales(size: f64) -> Scene {
    // On planes that face both cameras a flow and the one back cancel but for errors.
    let shift = |u: f64, v: f64, seed| shifted(&Tensor::from_fn(maps(3).with_c(2), |_, c, _, _| [u, v][c]), seed, size);
    let pair =
        |seed: u64| [shift(1.3, -0.6, seed), shift(1.3, -0.6, seed + 1), shift(-1.3, 0.6, seed + 2), shift(-1.3, 0.6, seed + 3)];
    Scene { leaves: [pair(10), pair(20)].concat(), data: vec![], cameras: cameras() }
}

#[test]
fn gradients_are_right_beside_hazards() {
    for seed in 0..3 {
        let nonsense =
            |x: f64, n: usize, h: usize, w: usize| if used().at(n, 0, h, w) == 0.0 { -3.0 * x + seed as f64 } else { x };
        let both = direct(0.4).with_leaf(1, |x, n, _, h, w| nonsense(x, n, h, w));
        assert_gradient(&Direct::Both, &both, CHECK);
        assert_gradient(&Direct::Rigid, &rigid_only(both), CHECK);
        // A point that the camera passes, which has no flow and no gradient.
        let passed =
            scene(-1.0, 0.2).with_leaf(0, |z, n, _, h, w| if (n, h, w) == (1, 3, 5) { 0.1 } else { nonsense(z, n, h, w) });
        assert_gradient(&Through(Direct::Both), &passed, CHECK);
        assert_gradient(&Scales, &scales(0.2 + 0.05 * seed as f64), CHECK);
    }
}

#[test]
fn masked_pixels_are_silent_whatever_stands_there() {
    let used = used();
    assert_silent(&Direct::Both, &direct(0.4), &[Some(used.clone()), Some(used.clone())]);
    assert_silent(&Direct::Rigid, &rigid_only(direct(0.4)), &[Some(used.clone())]);
    assert_silent(&Through(Direct::Both), &scene(-1.0, 0.2), &[Some(used.clone()), None, None, Some(used)]);
}

#[test]
fn numbers_are_finite_at_the_truth_and_without_pixels() {
    for scene in [scene(-1.0, 0.0), scene(1.0, 0.0), scene(-1.0, 0.2)] {
        for loss in [Through(Direct::Both), Through(Direct::Rigid)] {
            assert_finite(&loss, &scene);
            assert_nothing(&loss, &scene.clone().with_data(0, Tensor::zeros(maps(3))));
            // No motion at all, and every point behind the camera.
            assert_finite(&loss, &scene.scaled(&[1, 2, 3], 0.0));
            assert_finite(&loss, &scene.scaled(&[0], -1.0));
        }
    }
    assert_finite(&Scales, &scales(0.0));
    // Everything out of view.
    assert_nothing(&Scales, &scales(0.1).scaled(&[0, 1, 2, 3, 4, 5, 6, 7], 50.0));
}

#[test]
fn the_truth_costs_nothing_for_either_source() {
    for sign in [-1.0, 1.0] {
        for loss in [Through(Direct::Both), Through(Direct::Rigid)] {
            let (truth, wrong) = (scene(sign, 0.0), scene(sign, 0.0).scaled(&[0], 1.2));
            assert!(value(&loss, &truth) < 1e-12, "{loss:?}");
            assert!(value(&loss, &wrong) > 1e-2, "{loss:?}");
        }
    }
    assert!(value(&Scales, &scales(0.0)) < 1e-12);
}

#[test]
fn neither_the_order_nor_a_common_scale_matters() {
    let scene = scene(-1.0, 0.2);
    for loss in [Through(Direct::Both), Through(Direct::Rigid)] {
        assert_order_free(&loss, &scene);
        assert_same_value(&loss, &scene, &scene.scaled(&[0, 2], 2.7), 1e-12);
    }
    assert_order_free(&Scales, &scales(0.2));
}
