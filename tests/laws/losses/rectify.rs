//! The losses of the network that removes rotation.

use dimode::losses::rectify::{Supervision, rotation_consistency, rotation_triplet};
use dimode_autodiff::gradcheck::random;
use dimode_autodiff::{GradCheck, Scalar, Shape, Tensor, Var};

use crate::support::{Loss, Scene, assert_finite, assert_gradient, assert_nothing, assert_order_free, map};

const VECTORS: Shape = Shape([3, 3, 1, 1]);

/// Leaves are the angles of the three passes, data the known ones.
#[derive(Clone, Copy, Debug)]
enum Rectify {
    Consistency,
    Triplet,
}

impl Loss for Rectify {
    fn of<'t, T: Scalar>(&self, v: &[Var<'t, T>], scene: &Scene) -> Var<'t, T> {
        match self {
            Rectify::Consistency => rotation_consistency(v[2], &scene.data(0)),
            Rectify::Triplet => rotation_triplet(v[0], v[1]),
        }
    }
}

fn scene(seed: u64) -> Scene {
    let angles = |k| random::<f64>(seed + k, VECTORS, -0.1, 0.1);
    Scene { leaves: vec![angles(0), angles(1), angles(2)], data: vec![angles(3)], cameras: vec![] }
}

#[test]
fn gradients_are_right_and_the_order_does_not_matter() {
    for seed in [10, 20, 30] {
        for loss in [Rectify::Consistency, Rectify::Triplet] {
            assert_gradient(&loss, &scene(seed), GradCheck { step: 1e-6, ..GradCheck::default() });
            assert_order_free(&loss, &scene(seed));
        }
    }
}

#[test]
fn angles_of_zero_and_equal_angles_are_finite() {
    let known = scene(40).data[0].clone();
    assert_nothing(
        &Rectify::Consistency,
        &scene(40)
            .with_leaf(2, |_, n, c, _, _| f64::from(known.at(n, c, 0, 0) as f32))
            .with_data(0, map(&known, |x| f64::from(x as f32))),
    );
    for loss in [Rectify::Consistency, Rectify::Triplet] {
        assert_finite(&loss, &scene(50).scaled(&[0, 1, 2], 0.0));
    }
    // A rotation that is gone, of one that was large.
    assert_nothing(&Rectify::Triplet, &scene(60).scaled(&[1], 0.0).with_leaf(0, |x, _, _, _, _| x.signum()));
}

#[test]
fn the_order_of_the_batch_does_not_change_who_supervises() {
    let scene = scene(70);
    let turned = crate::support::reversed(&scene.leaves[0]);
    assert!(matches!(Supervision::of(&scene.leaves[0], 1), Supervision::Own(_)));
    assert_eq!(Supervision::of(&turned, 1), Supervision::Own(turned.clone()));
    // Drawn angles belong to places in the batch.
    let large = |x: &Tensor<f64>| Supervision::of(&map(x, |x| 10.0 * x), 1);
    assert_eq!(large(&scene.leaves[0]), large(&turned));
}
