//! `L_pla`, `L_axi`, `L_tan`, `L_rad` in every form, from maps on their own pixel grids to one number.

use dimode_autodiff::gradcheck::random;
use dimode_autodiff::{GradCheck, Scalar, Tensor, Var};
use dimode_geometry::Convention;
use dimode_geometry::losses::{
    AlignedPair, AxialForm, LossOptions, LossTerm, PairInputs, PlanarForm, RadialForm, TangentialForm, axial, planar, radial,
    tangential,
};
use dimode_geometry::taped::so3_exp;

use crate::scenes::{
    H, W, bent, between_pixels, cameras, facing_the_source, maps, mask, motion, motions, seen, shifted, vectors,
};
use crate::support::{
    Loss, Scene, assert_finite, assert_gradient, assert_nothing, assert_order_free, assert_same_value, assert_silent, map,
};

const CHECK: GradCheck = GradCheck { step: 1e-7, atol: 1e-6, rtol: 2e-5, allow_zero: false };

/// One of the four losses; leaves are target depth, source depth, flow, rotation vector and translation, data is the mask.
#[derive(Clone, Copy, Debug)]
pub struct Geometric {
    pub term: usize,
    pub options: LossOptions,
}

impl Geometric {
    /// The loss of every image.
    pub fn term<'t, T: Scalar>(&self, v: &[Var<'t, T>], scene: &Scene) -> LossTerm<'t, T> {
        let pair = AlignedPair::new(&inputs(v, scene, &scene.data(0)), &self.options);
        [planar, axial, tangential, radial][self.term](&pair, &self.options)
    }
}

impl Loss for Geometric {
    fn of<'t, T: Scalar>(&self, v: &[Var<'t, T>], scene: &Scene) -> Var<'t, T> {
        self.term(v, scene).mean
    }
}

pub fn inputs<'a, 't, T: Scalar>(v: &[Var<'t, T>], scene: &'a Scene, mask: &'a Tensor<T>) -> PairInputs<'a, 't, T> {
    PairInputs {
        target_depth: v[0],
        source_depth: v[1],
        flow: v[2],
        rotation: so3_exp(v[3]),
        translation: v[4],
        intrinsics: &scene.cameras,
        mask,
    }
}

/// The printed quantities with every hazard masked.
pub fn robust() -> LossOptions {
    LossOptions {
        convention: Convention::Consistent,
        planar: PlanarForm::Robust,
        axial: AxialForm::Folded,
        tangential: TangentialForm::Robust,
        radial: RadialForm::Robust,
        ..LossOptions::literal()
    }
}

/// The residuals in pixels, whole.
pub fn pixels() -> LossOptions {
    LossOptions {
        min_tangential_share: 0.0,
        min_tangential_flow: 0.0,
        noise_pixels: 0.0,
        noise_share: 0.0,
        min_valid_share: 0.01,
        detach_source_depth: false,
        ..LossOptions::default()
    }
}

/// Every form, in the consistent convention, and what training uses.
pub fn forms() -> Vec<LossOptions> {
    let base = LossOptions { gate: 50.0, ..robust() };
    vec![
        LossOptions { convention: Convention::Consistent, ..LossOptions::literal() },
        base,
        LossOptions { planar: PlanarForm::Weighted, axial: AxialForm::Signed, ..base },
        LossOptions {
            planar: PlanarForm::Circular,
            axial: AxialForm::PoseSign,
            tangential: TangentialForm::InverseRatio,
            radial: RadialForm::InverseRatio,
            ..base
        },
        pixels(),
        LossOptions { smooth_pixels: 0.05, noise_pixels: 0.02, noise_share: 0.03, ..pixels() },
        LossOptions { min_valid_share: 0.01, noise_pixels: 0.1, noise_share: 0.05, ..LossOptions::default() },
    ]
}

fn both_conventions() -> Vec<LossOptions> {
    forms().into_iter().flat_map(|o| [o, LossOptions { convention: Convention::AsPrinted, ..o }]).collect()
}

fn all(options: impl IntoIterator<Item = LossOptions>) -> impl Iterator<Item = Geometric> {
    options.into_iter().flat_map(|options| (0..4).map(move |term| Geometric { term, options }))
}

/// A scene whose source depth is given at the pixels of the source; everything is used.
fn scene_of(depth: Tensor<f64>, source: Tensor<f64>, flow: Tensor<f64>, motions: &[dimode_geometry::Se3]) -> Scene {
    let [w, t] = vectors(motions);
    let n = motions.len();
    Scene { leaves: vec![depth, source, flow, w, t], data: vec![mask(n, |_, _, _| true)], cameras: cameras()[..n].to_vec() }
}

/// Planes that face the source, without error.
fn exact(sign: f64) -> Scene {
    let motions = motions(sign);
    let depth = facing_the_source(6.0, &motions, &cameras());
    let [flow, _] = seen(&depth, &motions, &cameras());
    scene_of(depth, Tensor::full(maps(3), 6.0), flow, &motions)
}

/// The same with errors everywhere, away from kinks.
fn noisy(sign: f64, seed: u64) -> Scene {
    let mut scene = exact(sign);
    scene.leaves[0] = bent(&scene.leaves[0], seed, 0.1);
    scene.leaves[1] = bent(&scene.leaves[1], seed + 1, 0.1);
    scene.leaves[2] = between_pixels(&shifted(&scene.leaves[2], seed + 2, 0.5));
    scene.leaves[3] = bent(&scene.leaves[3], seed + 3, 0.2);
    scene.leaves[4] = bent(&scene.leaves[4], seed + 4, 0.2);
    scene
}

/// Noise, a principal point on a pixel, pixels out of view, behind the camera or masked with nonsense, a last image without any.
fn hazardous(sign: f64, seed: u64) -> Scene {
    let used = mask(3, |n, h, w| n < 2 && (h, w) != (1, 2) && (h, w) != (4, 5) && (h, w) != (2, 6));
    noisy(sign, seed)
        .with_leaf(2, |f, n, c, h, w| match (n, c, h, w) {
            // Far out of view on one side, just out of it on the other; no flow and a huge one where masked.
            (_, 0, 0, 3) => 40.0,
            (_, 1, 5, 1) => 0.3,
            (_, _, 1, 2) => 0.0,
            (_, _, 4, 5) => -1e3,
            (1, c, 3, 3) => [0.4, -0.3][c],
            _ => f,
        })
        .with_leaf(1, |d, n, _, h, w| {
            // The source is so near here that alignment puts it behind a camera that moves ahead.
            if n == 1 && (2..4).contains(&h) && (3..5).contains(&w) { 0.05 * d } else { d }
        })
        .with_leaf(0, |d, _, _, h, w| match (h, w) {
            (1, 2) => 0.0,
            (4, 5) => -3.0,
            (2, 6) => 1e8,
            // Unmasked, but no depth.
            (5, 7) => -0.5,
            _ => d,
        })
        .with_data(0, used)
}

#[test]
fn gradients_are_right_beside_hazards() {
    for (sign, seed, options) in [(-1.0, 10, forms()), (1.0, 20, both_conventions()), (-1.0, 30, forms())] {
        let scene = hazardous(sign, seed);
        for loss in all(options) {
            // Differences would see what is detached.
            let loss = Geometric { options: LossOptions { detach_source_depth: false, ..loss.options }, ..loss };
            // Means over pixels of weight 0 to 1 as well.
            if seed != 30 {
                assert_gradient(&loss, &scene, CHECK);
            } else {
                let weights = random::<f64>(seed, maps(3), 0.2, 0.9);
                let soft =
                    Tensor::from_vec(maps(3), weights.data().iter().zip(scene.data[0].data()).map(|(w, m)| w * m).collect());
                assert_gradient(&loss, &scene.clone().with_data(0, soft), CHECK);
            }
        }
    }
}

/// Scenes at which something is exactly 0, parallel or nowhere.
fn degenerate() -> Vec<(&'static str, Scene)> {
    let of = |t: [f64; 3], w: [f64; 3]| {
        let motions = vec![motion(w, t); 3];
        let depth = facing_the_source(6.0, &motions, &cameras());
        let [flow, _] = seen(&depth, &motions, &cameras());
        scene_of(depth, Tensor::full(maps(3), 6.0), flow, &motions)
    };
    let turn = [0.02, -0.01, 0.015];
    let still = || {
        scene_of(
            Tensor::full(maps(3), 5.0),
            Tensor::full(maps(3), 5.0),
            Tensor::zeros(maps(3).with_c(2)),
            &vec![motion([0.0; 3], [0.0; 3]); 3],
        )
    };
    let nonsense = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.0, -1.0];
    let here = |n: usize, c: usize, h: usize, w: usize| (h + w).is_multiple_of(3).then(|| nonsense[(n + c + h + 2 * w) % 5]);
    let spoilt = |k: usize| noisy(-1.0, 40).with_leaf(k, |x, n, c, h, w| here(n, c, h, w).unwrap_or(x));
    vec![
        ("exact, ahead", exact(-1.0)),
        ("exact, back", exact(1.0)),
        ("sideways", of([0.5, 0.0, 0.0], [0.0; 3])),
        ("the other side, turning", of([-0.5, 0.0, 0.0], turn)),
        ("up", of([0.0, 0.5, 0.0], [0.0; 3])),
        ("ahead", of([0.0, 0.0, -0.5], [0.0; 3])),
        ("back, turning", of([0.0, 0.0, 0.5], turn)),
        ("no translation", of([0.0; 3], turn)),
        ("no motion", still()),
        ("no flow of a moving camera", hazardous(-1.0, 50).with_leaf(2, |_, _, _, _, _| 0.0)),
        ("no mask", hazardous(-1.0, 60).with_data(0, Tensor::zeros(maps(3)))),
        ("all behind", hazardous(1.0, 70).with_leaf(1, |d, _, _, _, _| 0.01 * d)),
        ("nonsense in the target depth", spoilt(0)),
        ("nonsense in the source depth", spoilt(1)),
        ("nonsense in the flow", spoilt(2)),
        ("hazards", hazardous(1.0, 80)),
    ]
}

/// The printed angles, whose arccos has an infinite derivative where a cosine is exactly 1 or -1.
fn by_arccos(loss: &Geometric) -> bool {
    match loss.term {
        0 => loss.options.planar == PlanarForm::Literal,
        1 => loss.options.axial == AxialForm::Literal,
        _ => false,
    }
}

#[test]
fn numbers_are_finite_at_hazards() {
    for (name, scene) in degenerate() {
        println!("{name}");
        all(both_conventions()).filter(|l| !by_arccos(l)).for_each(|loss| assert_finite(&loss, &scene));
    }
}

#[test]
fn printed_angles_are_finite_also_at_exact_cosines() {
    for (name, scene) in degenerate() {
        println!("{name}");
        all(both_conventions()).filter(by_arccos).for_each(|loss| assert_finite(&loss, &scene));
    }
}

#[test]
fn masked_pixels_are_silent_whatever_stands_there() {
    // Only columns up to 3 are used; their flows end before column 6, so source pixels from there on are not read.
    let used = mask(3, |n, h, w| n < 2 && w < 4 && (h + w) % 4 != 0);
    let read = mask(3, |n, _, w| n < 2 && w < 6);
    let scene = noisy(-1.0, 90).with_data(0, used.clone());
    let scene = scene.with_leaf(2, |f, _, c, _, w| if c == 0 && w < 4 { f.clamp(-1.3, 1.3) } else { f });
    for loss in all(both_conventions()) {
        let full = LossOptions { detach_source_depth: false, ..loss.options };
        let loss = Reading(Geometric { options: full, ..loss });
        let masks = [Some(used.clone()), Some(read.clone()), Some(used.clone()), None, None];
        assert_silent(&loss, &scene, &masks);
    }
}

/// A loss plus one that reads every leaf, so that each has a gradient.
#[derive(Debug)]
struct Reading(Geometric);

impl Loss for Reading {
    fn of<'t, T: Scalar>(&self, v: &[Var<'t, T>], scene: &Scene) -> Var<'t, T> {
        let other = Geometric { term: 2, options: LossOptions { convention: Convention::Consistent, ..pixels() } };
        self.0.of(v, scene).add(other.of(v, scene))
    }
}

#[test]
fn an_image_without_pixels_counts_for_nothing() {
    let scene = hazardous(-1.0, 100);
    for loss in all(both_conventions()) {
        assert_nothing(&loss, &scene.clone().with_data(0, Tensor::zeros(maps(3))));
        // The last image of three has none: the mean is that of the other two, and all its leaves are silent.
        let tape = dimode_autodiff::Tape::<f64>::new();
        let v: Vec<_> = scene.leaves.iter().map(|x| tape.leaf(x.clone())).collect();
        let term = loss.term(&v, &scene);
        assert_eq!(term.counts[2], 0, "{loss:?}");
        let per_image = term.per_image.value();
        let counting: Vec<f64> = (0..2).filter(|&n| term.counts[n] > 0).map(|n| per_image.data()[n]).collect();
        let mean = counting.iter().sum::<f64>() / counting.len().max(1) as f64;
        assert!((term.mean.value().item() - mean).abs() <= 1e-12 * mean.abs(), "{loss:?}");
        let grads = tape.backward(term.mean);
        for x in &v {
            let grad = grads.wrt(*x);
            let each = grad.data().len() / 3;
            assert!(grad.data()[2 * each..].iter().all(|&g| g == 0.0), "{loss:?}");
        }
    }
}

#[test]
fn the_order_of_the_batch_does_not_matter() {
    let scene = hazardous(-1.0, 110);
    for loss in all(both_conventions()) {
        assert_order_free(&loss, &scene);
    }
}

#[test]
fn a_common_scale_of_depths_and_translation_does_not_matter() {
    let scene = noisy(-1.0, 120);
    for loss in all(both_conventions()) {
        for factor in [0.4, 3.0] {
            assert_same_value(&loss, &scene, &scene.scaled(&[0, 1, 4], factor), 1e-10);
        }
    }
}

#[test]
fn the_share_of_a_mask_does_not_matter_but_its_weights_do() {
    let (scene, weights) = (noisy(-1.0, 130), random::<f64>(131, maps(3), 0.1, 0.4));
    for loss in all(forms()) {
        let soft = |factor: f64, power: i32| scene.clone().with_data(0, map(&weights, |w| factor * w.powi(power)));
        assert_same_value(&loss, &soft(1.0, 1), &soft(2.0, 1), 1e-11);
        let [one, other] = [soft(1.0, 1), soft(1.0, 3)].map(|s| crate::support::value(&loss, &s));
        assert!((one - other).abs() > 1e-6 * one.abs(), "{loss:?}: {one} {other}");
    }
}

#[test]
fn what_is_in_view_decides_which_pixels_are_read() {
    // Moving every flow of a row out of view is the same as masking that row.
    let scene = noisy(-1.0, 140);
    for loss in all(forms()) {
        let out = scene.clone().with_leaf(2, |f, _, c, h, _| if c == 1 && h == 2 { H as f64 } else { f });
        let masked = scene.clone().with_data(0, mask(3, |_, h, _| h != 2));
        assert_same_value(&loss, &out, &masked, 1e-13);
        let wide = scene.clone().with_leaf(2, |f, _, c, h, _| if c == 0 && h == 2 { -(W as f64) } else { f });
        assert_same_value(&loss, &wide, &masked, 1e-13);
    }
}
