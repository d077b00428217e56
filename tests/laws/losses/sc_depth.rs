//! Pair terms of both SC-Depth programs.

use dimode::losses::masked::batch_mean;
use dimode::losses::view_pair::{View, ViewPair};
use dimode::losses::{sc_depth_pair, sc_sfm_pair};
use dimode_autodiff::{GradCheck, Scalar, Tape, Tensor, Var};
use dimode_geometry::taped::{Pose, SampleGrid, so3_exp};

use crate::scenes::{H, W, bent, cameras, facing_the_source, images, maps, motion, motions, vectors};
use crate::support::{
    Loss, Scene, assert_finite, assert_gradient, assert_nothing, assert_order_free, assert_same_value, gradients, map,
};

const CHECK: GradCheck = GradCheck { step: 1e-7, rtol: 1e-5, atol: 1e-7, allow_zero: false };

#[derive(Clone, Copy, Debug, PartialEq)]
enum Program {
    /// The Lightning version.
    Later(SampleGrid),
    /// SC-SfMLearner-Release.
    First(SampleGrid),
}

const PROGRAMS: [Program; 4] = [
    Program::Later(SampleGrid::Pixels),
    Program::Later(SampleGrid::HalfPixelAsCoded),
    Program::First(SampleGrid::Pixels),
    Program::First(SampleGrid::HalfPixelAsCoded),
];

/// Leaves are target image and depth, reference image and depth, rotation vector and translation from target to reference.
#[derive(Clone, Copy, Debug)]
struct Pair {
    program: Program,
    /// Also the other direction.
    both: bool,
    geometry: bool,
    min_pixels: usize,
}

fn pair<'a, 't, T: Scalar>(v: &[Var<'t, T>], scene: &'a Scene) -> ViewPair<'a, 't, T> {
    ViewPair {
        target: View { image: v[0], depth: v[1] },
        reference: View { image: v[2], depth: v[3] },
        motion: Pose { rotation: so3_exp(v[4]), translation: v[5] },
        intrinsics: &scene.cameras,
    }
}

impl Loss for Pair {
    fn of<'t, T: Scalar>(&self, v: &[Var<'t, T>], scene: &Scene) -> Var<'t, T> {
        let there = pair(v, scene);
        let mut pairs = vec![there];
        if self.both {
            pairs.push(there.exchanged(there.motion.inverse()));
        }
        let loss = match self.program {
            Program::Later(grid) => {
                let maps: Vec<_> = pairs.iter().map(|p| sc_depth_pair::pair_maps(p, grid)).collect();
                sc_depth_pair::pair_loss(&maps, self.min_pixels)
            }
            Program::First(grid) => {
                let maps: Vec<_> = pairs.iter().map(|p| sc_sfm_pair::pair_maps(p, grid)).collect();
                sc_sfm_pair::pair_loss(&maps, self.min_pixels)
            }
        };
        if self.geometry { loss.geometry } else { loss.photo }
    }
}

fn all() -> impl Iterator<Item = Pair> {
    PROGRAMS.into_iter().flat_map(|program| {
        [(false, false), (false, true), (true, false), (true, true)].map(|(both, geometry)| Pair {
            program,
            both,
            geometry,
            min_pixels: 0,
        })
    })
}

/// Colours with the mean of the SC-Depth programs.
fn normalised(seed: u64) -> Tensor<f64> {
    map(&images(3, seed), |x| (x - 0.45) / 0.225)
}

fn scene(sign: f64, seed: u64) -> Scene {
    let motions = motions(sign);
    let depth = facing_the_source(6.0, &motions, &cameras());
    let [w, t] = vectors(&motions);
    let reference = bent(&Tensor::full(maps(3), 6.0), seed, 0.2);
    let leaves = vec![normalised(seed), bent(&depth, seed + 1, 0.2), normalised(seed + 7), reference, w, t];
    Scene { leaves, data: vec![], cameras: cameras() }
}

/// With points that the camera passes, and others that leave the view.
fn hazardous(sign: f64, seed: u64) -> Scene {
    scene(sign, seed).with_leaf(1, |d, n, _, h, w| match (n, h, w) {
        (_, 2, 3) => 0.2,
        (0, 4, 1) => 0.7,
        _ => d,
    })
}

#[test]
fn gradients_are_right_beside_hazards() {
    for (sign, seed) in [(-1.0, 10), (1.0, 20)] {
        for loss in all() {
            // The later program stops its weight: differences would see it.
            let stopped = matches!(loss.program, Program::Later(_)) && !loss.geometry;
            if !stopped {
                assert_gradient(&loss, &hazardous(sign, seed), CHECK);
            }
        }
    }
}

/// The photometric loss of the later program, one direction, with the weight as data and not as a function of the depths.
#[derive(Debug)]
struct Weighted(SampleGrid);

impl Loss for Weighted {
    fn of<'t, T: Scalar>(&self, v: &[Var<'t, T>], scene: &Scene) -> Var<'t, T> {
        let maps = sc_depth_pair::pair_maps(&pair(v, scene), self.0);
        let weight = maps.depth_difference.detach().scale(-1.0).add_scalar(1.0);
        let unweighted = maps.image_difference.div_guarded(weight, 1e-9);
        batch_mean(unweighted.mul(v[0].tape().constant(scene.data(0))), &scene.data(1), 0)
    }
}

#[test]
fn the_photometric_loss_under_a_stopped_weight_has_its_own_gradient() {
    for grid in [SampleGrid::Pixels, SampleGrid::HalfPixelAsCoded] {
        let mut scene = hazardous(-1.0, 25);
        let tape = Tape::<f64>::new();
        let v: Vec<_> = scene.leaves.iter().map(|x| tape.leaf(x.clone())).collect();
        let maps = sc_depth_pair::pair_maps(&pair(&v, &scene), grid);
        scene.data = vec![map(&maps.depth_difference.value(), |d| 1.0 - d), maps.valid.clone()];
        assert_gradient(&Weighted(grid), &scene, CHECK);
        let whole = Pair { program: Program::Later(grid), both: false, geometry: false, min_pixels: 0 };
        let ((a, free), (b, own)) = (gradients::<f64>(&Weighted(grid), &scene), gradients::<f64>(&whole, &scene));
        assert!((a - b).abs() < 1e-14 && own[3].data().iter().all(|&g| g == 0.0));
        for (free, own) in free.iter().zip(&own) {
            assert!(free.data().iter().zip(own.data()).all(|(a, b)| (a - b).abs() < 1e-13));
        }
    }
}

#[test]
fn numbers_are_finite_at_hazards() {
    let black = |scene: Scene| scene.scaled(&[0, 2], 0.0);
    let still = vectors(&vec![motion([0.0; 3], [0.0; 3]); 3]);
    let resting = |scene: Scene| {
        scene.with_leaf(4, |_, n, c, _, _| still[0].at(n, c, 0, 0)).with_leaf(5, |_, n, c, _, _| still[1].at(n, c, 0, 0))
    };
    for scene in [
        hazardous(-1.0, 30),
        hazardous(1.0, 30),
        resting(scene(-1.0, 30)),
        black(scene(-1.0, 40)),
        // Equal views of one wall, without motion.
        resting(scene(-1.0, 40)).with_leaf(2, |_, n, c, h, w| normalised(40).at(n, c, h, w)),
        scene(-1.0, 50).scaled(&[5], 30.0),
        scene(1.0, 50).scaled(&[5], 30.0),
        scene(-1.0, 50).scaled(&[1], -1.0),
        // Every point exactly in the plane of the reference camera.
        resting(scene(-1.0, 50)).with_leaf(1, |_, _, _, _, _| 1.0).with_leaf(5, |_, _, c, _, _| if c == 2 { -1.0 } else { 0.0 }),
    ] {
        for loss in all() {
            assert_finite(&loss, &scene);
        }
    }
}

#[test]
fn too_few_pixels_cost_nothing() {
    for loss in all() {
        assert_nothing(&Pair { min_pixels: 10_000, ..loss }, &scene(-1.0, 60));
    }
}

#[test]
fn pixels_that_do_not_count_are_silent() {
    for loss in all().filter(|l| !l.both && l.geometry) {
        let scene = hazardous(-1.0, 70);
        let tape = Tape::<f64>::new();
        let v: Vec<_> = scene.leaves.iter().map(|x| tape.leaf(x.clone())).collect();
        let valid = match loss.program {
            Program::Later(grid) => sc_depth_pair::pair_maps(&pair(&v, &scene), grid).valid,
            Program::First(grid) => sc_sfm_pair::pair_maps(&pair(&v, &scene), grid).valid,
        };
        let (_, grads) = gradients::<f64>(&loss, &scene);
        let mut used = 0;
        for (g, &m) in grads[1].data().iter().zip(valid.data()) {
            assert!(m != 0.0 || *g == 0.0, "{loss:?}");
            used += usize::from(*g != 0.0);
        }
        assert!(used > 5, "{loss:?}");
        if matches!(loss.program, Program::Later(_)) {
            assert!((0..3).all(|n| valid.at(n, 0, 2, 3) == 0.0), "a point behind the camera counts");
        }
    }
}

#[test]
fn depths_agree_exactly_where_the_wall_faces_the_reference() {
    for sign in [-1.0, 1.0] {
        let (motions, k) = (motions(sign), cameras());
        let depth = facing_the_source(6.0, &motions, &k);
        let truth = scene(sign, 80).with_leaf(1, |_, n, _, h, w| depth.at(n, 0, h, w)).with_leaf(3, |_, _, _, _, _| 6.0);
        let tape = Tape::<f64>::new();
        let v: Vec<_> = truth.leaves.iter().map(|x| tape.leaf(x.clone())).collect();
        let there = pair(&v, &truth);
        let [later, first] = [
            sc_depth_pair::pair_maps(&there, SampleGrid::Pixels).depth_difference.value(),
            sc_sfm_pair::pair_maps(&there, SampleGrid::Pixels).depth_difference.value(),
        ];
        let pixels = sc_sfm_pair::pair_maps(&there, SampleGrid::Pixels);
        let mut inside = 0;
        for i in 0..3 * H * W {
            if pixels.in_view.data()[i] != 0.0 {
                inside += 1;
                assert!(later.data()[i] < 1e-14 && first.data()[i] < 1e-14, "{} {}", later.data()[i], first.data()[i]);
            }
        }
        assert!(inside > 70, "{inside}");
    }
}

#[test]
fn neither_the_order_nor_a_common_scale_matters() {
    let scene = scene(-1.0, 90);
    for loss in all() {
        assert_order_free(&loss, &scene);
        // The guard of the division, 1e-7, is in units of depth.
        for factor in [0.5, 4.0] {
            assert_same_value(&loss, &scene, &scene.scaled(&[1, 3, 5], factor), 1e-6);
        }
    }
}
