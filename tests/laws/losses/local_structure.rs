//! Normals: their matching and the angles between them.

use dimode::losses::edge_pairs::Pairs;
use dimode::losses::local_structure::{normal_matching, normals};
use dimode::losses::relative_normal::{edge_guided_relative_normal, relative_normal};
use dimode_autodiff::gradcheck::random;
use dimode_autodiff::{GradCheck, Scalar, Shape, Tape, Tensor, Var};
use dimode_geometry::Intrinsics;
use nalgebra::Vector3;

use crate::scenes::{cameras, images, maps, plane};
use crate::support::{
    Loss, Scene, assert_finite, assert_gradient, assert_nothing, assert_order_free, assert_same_value, gradients, map, value,
};

const CHECK: GradCheck = GradCheck { step: 1e-6, rtol: 1e-5, atol: 1e-8, allow_zero: false };

/// The leaf is the depth; data are the pseudo-depth, the number of each sample and images.
#[derive(Clone, Copy, Debug)]
enum Structure {
    Matching,
    /// Over pairs that belong to each sample.
    Angles,
    /// Over pairs of a seed, which belong to places in the batch.
    Guided,
}

impl Loss for Structure {
    fn of<'t, T: Scalar>(&self, v: &[Var<'t, T>], scene: &Scene) -> Var<'t, T> {
        let pseudo = scene.data(0);
        match self {
            Structure::Matching => normal_matching(v[0], &pseudo, &scene.cameras),
            Structure::Angles => {
                let own: Vec<_> = scene.data[1].data().iter().map(|&n| pairs(n as usize)).collect();
                relative_normal(v[0], &pseudo, &scene.cameras, &own)
            }
            Structure::Guided => edge_guided_relative_normal(v[0], &pseudo, &scene.data(2), &scene.cameras, 3),
        }
    }
}

const FORMS: [Structure; 3] = [Structure::Matching, Structure::Angles, Structure::Guided];

fn pairs(sample: usize) -> Pairs {
    match sample {
        0 => Pairs { a: vec![8, 9, 30, 8], b: vec![17, 22, 11, 33] },
        1 => Pairs { a: vec![10, 25], b: vec![29, 10] },
        _ => Pairs::default(),
    }
}

fn scene(seed: u64) -> Scene {
    let numbers = Tensor::from_vec(Shape::new(3, 1, 1, 1), vec![0.0, 1.0, 2.0]);
    let data = vec![random(seed + 1, maps(3), 1.0, 1.4), numbers, images(3, seed + 2)];
    Scene { leaves: vec![random(seed, maps(3), 2.0, 2.6)], data, cameras: cameras() }
}

/// Maps large enough for edges of normals, whose frame of five pixels is left out.
fn large(seed: u64) -> Scene {
    let shape = Shape::new(2, 1, 13, 14);
    let camera = |u0| Intrinsics::new(20.0, 21.0, u0, 6.0, 14, 13).unwrap();
    let image = random(seed + 2, shape.with_c(3), 0.0, 1.0);
    let data = vec![random(seed + 1, shape, 1.0, 1.4), Tensor::zeros(Shape::new(2, 1, 1, 1)), image];
    Scene { leaves: vec![random(seed, shape, 2.0, 2.6)], data, cameras: vec![camera(7.0), camera(6.3)] }
}

#[test]
fn gradients_are_right() {
    for seed in [10, 20] {
        for form in FORMS {
            assert_gradient(&form, &scene(seed), CHECK);
        }
        assert_gradient(&Structure::Guided, &large(seed), CHECK);
    }
}

#[test]
fn numbers_are_finite_on_planes_folds_and_points() {
    let truth = |scene: Scene| scene.clone().with_data(0, scene.leaves[0].clone());
    let facing = scene(30).with_leaf(0, |_, _, _, _, _| 2.0);
    for form in FORMS {
        // Normals equal to the wanted ones, also where they have components of 0.
        assert_finite(&form, &truth(scene(30)));
        assert_finite(&form, &truth(facing.clone()));
        assert_finite(&form, &facing);
        // Against a point, from a point, and with one hole.
        assert_finite(&form, &scene(30).scaled(&[0], 0.0));
        assert_finite(&form, &scene(30).with_data(0, Tensor::zeros(maps(3))));
        assert_finite(&form, &scene(30).with_leaf(0, |d, _, _, h, w| if (h, w) == (3, 4) { 0.0 } else { d }));
        // A surface seen edge-on: a step of a thousand.
        assert_finite(&form, &scene(30).with_leaf(0, |d, _, _, _, w| if w > 3 { 1e3 * d } else { d }));
    }
    assert_nothing(&Structure::Matching, &truth(facing));
}

#[test]
fn images_without_pairs_and_pixels_away_from_them_are_silent() {
    let (_, grads) = gradients::<f64>(&Structure::Angles, &scene(40));
    let near = |n: usize, h: usize, w: usize| {
        let all = pairs(n);
        all.a.iter().chain(&all.b).any(|&p| (p / 8).abs_diff(h) < 2 && (p % 8).abs_diff(w) < 2)
    };
    for n in 0..3 {
        for (i, &g) in grads[0].plane(n, 0).iter().enumerate() {
            assert!(g == 0.0 || near(n, i / 8, i % 8), "image {n}, pixel {i}: {g}");
        }
    }
    assert!(grads[0].plane(0, 0).iter().any(|&g| g != 0.0) && grads[0].plane(2, 0).iter().all(|&g| g == 0.0));
}

#[test]
fn planes_have_their_normal_and_cost_nothing_against_themselves() {
    let normal = Vector3::new(0.2, -0.3, 1.0).normalize();
    let depth = plane(&[normal; 3], &[6.0, 5.0, 7.0], &cameras());
    let tape = Tape::<f64>::new();
    let found = normals(tape.constant(depth.clone()), &cameras()).value();
    for n in 0..3 {
        for c in 0..3 {
            assert!(found.plane(n, c).iter().all(|x| (x - normal[c]).abs() < 1e-12));
        }
    }
    for form in FORMS {
        let truth = scene(50).with_data(0, map(&depth, |d| 0.3 * d)).with_leaf(0, |_, n, _, h, w| depth.at(n, 0, h, w));
        assert!(value(&form, &truth) < 1e-12, "{form:?}");
    }
}

#[test]
fn neither_the_order_nor_scales_matter() {
    let scene = scene(60);
    for form in FORMS {
        if !matches!(form, Structure::Guided) {
            assert_order_free(&form, &scene);
        }
        for factor in [0.01, 50.0] {
            assert_same_value(&form, &scene, &scene.scaled(&[0], factor), 1e-9);
            let other = scene.clone().with_data(0, map(&scene.data[0], |x| factor * x));
            assert_same_value(&form, &scene, &other, 1e-9);
        }
    }
}
