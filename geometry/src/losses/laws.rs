//! Laws of every form of the losses: agreement with the plain sums, zero at the truth, scale, gradients.

use dimode_autodiff::gradcheck::random;
use dimode_autodiff::{GradCheck, Shape, Tape, Tensor, Var, gradcheck};
use nalgebra::{Vector2, Vector3};

use super::*;
use crate::alignment::Convention;
use crate::camera::Intrinsics;
use crate::taped::pose::pose_tensors;
use crate::taped::{masks, rigid_flow, so3_exp};
use crate::{Se3, loss_forms, so3};

const H: usize = 9;
const W: usize = 14;

/// Leaves of a pair: target depth, source depth at the flow's ends, flow, rotation vector, translation.
type Leaves = [Tensor<f64>; 5];

fn cameras() -> [Intrinsics; 2] {
    [Intrinsics::new(20.0, 21.0, 6.3, 4.2, W, H).unwrap(), Intrinsics::new(18.0, 17.0, 7.1, 3.6, W, H).unwrap()]
}

fn shape(c: usize) -> Shape {
    Shape::new(2, c, H, W)
}

fn motions(radial: [f64; 2]) -> [Se3; 2] {
    let motion = |w: [f64; 3], t: [f64; 3]| Se3::from_rotation_vector(&w.into(), t.into());
    [motion([0.02, -0.04, 0.03], [0.35, -0.25, radial[0]]), motion([-0.03, 0.02, 0.01], [-0.3, 0.4, radial[1]])]
}

/// A static scene seen without error.
fn exact(motions: [Se3; 2]) -> Leaves {
    let tape = Tape::new();
    let depth = random(7, shape(1), 3.0, 8.0);
    let (r, t) = pose_tensors(&motions);
    let rigid = rigid_flow(tape.constant(depth.clone()), tape.constant(r), tape.constant(t.clone()), &cameras());
    let w = motions.map(|m| so3::log(&m.rotation));
    let w = Tensor::from_fn(Shape::new(2, 3, 1, 1), |n, i, _, _| w[n][i]);
    [depth, rigid.slice(1, 2, 1).value(), rigid.slice(1, 0, 2).value(), w, t]
}

/// The scene with errors everywhere.
fn perturbed(motions: [Se3; 2]) -> Leaves {
    let [depth, source, flow, w, t] = exact(motions);
    let bend = |x: &Tensor<f64>, seed, size: f64| {
        let noise = random::<f64>(seed, x.shape(), 1.0 - size, 1.0 + size);
        Tensor::from_vec(x.shape(), x.data().iter().zip(noise.data()).map(|(x, n)| x * n).collect())
    };
    [bend(&depth, 1, 0.1), bend(&source, 2, 0.1), bend(&flow, 3, 0.2), bend(&w, 4, 0.2), bend(&t, 5, 0.2)]
}

fn pair_of<'t>(v: &[Var<'t, f64>], mask: &Tensor<f64>, options: &LossOptions) -> AlignedPair<'t, f64> {
    let inputs = PairInputs {
        target_depth: v[0],
        source_depth: v[1],
        flow: v[2],
        rotation: so3_exp(v[3]),
        translation: v[4],
        intrinsics: &cameras(),
        mask,
    };
    AlignedPair::from_sampled(&inputs, options)
}

/// `L_pla`, `L_axi`, `L_tan`, `L_rad` by number.
fn one<'t>(v: &[Var<'t, f64>], options: &LossOptions, term: usize) -> LossTerm<'t, f64> {
    let pair = pair_of(v, &masks::everywhere(shape(1)), options);
    [planar, axial, tangential, radial][term](&pair, options)
}

fn all<'t>(v: &[Var<'t, f64>], options: &LossOptions) -> [LossTerm<'t, f64>; 4] {
    std::array::from_fn(|term| one(v, options, term))
}

fn values(leaves: &Leaves, options: &LossOptions) -> [Vec<f64>; 4] {
    let tape = Tape::new();
    let v = leaves.clone().map(|x| tape.leaf(x));
    all(&v, options).map(|t| t.per_image.value().to_vec())
}

/// The printed quantities with every hazard masked, in the exact convention.
fn robust() -> LossOptions {
    LossOptions {
        convention: Convention::Consistent,
        planar: PlanarForm::Robust,
        axial: AxialForm::Folded,
        tangential: TangentialForm::Robust,
        radial: RadialForm::Robust,
        ..LossOptions::literal()
    }
}

/// The pixel forms of every image and of every residual.
fn pixels() -> LossOptions {
    LossOptions {
        min_tangential_share: 0.0,
        noise_pixels: 0.0,
        noise_share: 0.0,
        min_valid_share: 0.01,
        detach_source_depth: false,
        ..LossOptions::default()
    }
}

/// Every form at least once, all with the exact convention.
fn presets() -> Vec<LossOptions> {
    let base = LossOptions { gate: 50.0, ..robust() };
    let literal = LossOptions { convention: Convention::Consistent, ..LossOptions::literal() };
    vec![
        literal,
        base,
        LossOptions { smooth_pixels: 0.05, ..pixels() },
        LossOptions { noise_pixels: 0.02, noise_share: 0.03, ..pixels() },
        LossOptions {
            planar: PlanarForm::Circular,
            axial: AxialForm::PoseSign,
            tangential: TangentialForm::InverseRatio,
            radial: RadialForm::InverseRatio,
            ..base
        },
        LossOptions { planar: PlanarForm::Weighted, axial: AxialForm::Signed, ..base },
    ]
}

#[test]
fn exact_static_scenes_cost_nothing_for_either_source() {
    for radial in [[-0.5, -0.4], [0.6, 0.5]] {
        for options in presets() {
            let found = values(&exact(motions(radial)), &options);
            for (term, values) in found.iter().enumerate() {
                let signed = matches!(options.axial, AxialForm::Literal | AxialForm::Signed);
                let expected = if term == 1 && signed && radial[0] > 0.0 { std::f64::consts::PI } else { 0.0 };
                for x in values {
                    let rounded = matches!(options.planar, PlanarForm::Literal);
                    // An arccos near cosine 1 keeps half of the digits.
                    let tolerance = if rounded { 1e-7 } else { 1e-11 };
                    assert!((x - expected).abs() < tolerance, "term {term} of {options:?}: {x}");
                }
            }
        }
    }
}

#[test]
fn axes_that_do_not_count_are_left_out_of_the_ratios() {
    let leaves = perturbed(motions([-0.5, -0.4]));
    for base in presets().into_iter().filter(|o| o.tangential != TangentialForm::FlowPixels) {
        let [all, x, y, none] = [[true; 3], [true, false, true], [false, true, false], [false; 3]]
            .map(|axes| values(&leaves, &LossOptions { axes, ..base }));
        for n in 0..2 {
            assert!((x[2][n] + y[2][n] - all[2][n]).abs() < 1e-12 && x[2][n] > 0.0 && y[2][n] > 0.0, "{base:?}");
            assert_eq!((none[2][n], none[3][n], y[3][n], x[3][n]), (0.0, 0.0, 0.0, all[3][n]), "{base:?}");
            assert_eq!((none[0][n], none[1][n]), (all[0][n], all[1][n]), "{base:?}");
        }
    }
}

#[test]
fn printed_convention_leaves_a_residual() {
    let options = LossOptions { convention: Convention::AsPrinted, ..robust() };
    let found = values(&exact(motions([-0.5, -0.4])), &options);
    assert!(found[1][0] > 0.01 && found[2][0] > 0.01, "{found:?}");
}

#[test]
fn a_common_scale_of_depths_and_translation_changes_nothing() {
    let [z, d, f, w, t] = perturbed(motions([-0.5, 0.5]));
    let scaled = |x: &Tensor<f64>| Tensor::from_vec(x.shape(), x.data().iter().map(|x| 1.7 * x).collect());
    for options in presets() {
        let one = values(&[z.clone(), d.clone(), f.clone(), w.clone(), t.clone()], &options);
        let two = values(&[scaled(&z), scaled(&d), f.clone(), w.clone(), scaled(&t)], &options);
        for (a, b) in one.iter().flatten().zip(two.iter().flatten()) {
            assert!((a - b).abs() < 1e-9 * (1.0 + a.abs()), "{options:?}: {a} {b}");
        }
    }
}

#[test]
fn gradients_match_differences() {
    let inputs = perturbed(motions([-0.5, 0.55]));
    let settings = GradCheck { step: 1e-7, atol: 2e-7, rtol: 1e-5, ..GradCheck::default() };
    for options in presets() {
        for term in 0..4 {
            let report = gradcheck(&inputs, |_, v| one(v, &options, term).mean, settings);
            assert!(report.is_ok(), "term {term} of {options:?}\n{report}");
        }
    }
}

/// Weights of a soft mask, two columns of them 0.
fn soft() -> Tensor<f64> {
    let weights = random::<f64>(9, shape(1), 0.2, 0.5);
    Tensor::from_fn(shape(1), |n, c, h, w| if w < 2 { 0.0 } else { weights.at(n, c, h, w) })
}

#[test]
fn gradients_under_soft_weights_match_differences() {
    let inputs = perturbed(motions([-0.5, 0.55]));
    let settings = GradCheck { step: 1e-7, atol: 2e-7, rtol: 1e-5, ..GradCheck::default() };
    for options in presets() {
        type Loss = for<'t> fn(&AlignedPair<'t, f64>, &LossOptions) -> LossTerm<'t, f64>;
        for loss in [planar as Loss, axial, tangential, radial] {
            gradcheck(&inputs, |_, v| loss(&pair_of(v, &soft(), &options), &options).mean, settings).assert_ok();
        }
    }
}

#[test]
fn soft_weights_weigh_and_only_their_ratios_matter() {
    let leaves = perturbed(motions([-0.5, 0.55]));
    let under = |factor: f64, power: i32, options: &LossOptions| -> Vec<f64> {
        let weights = soft();
        let weights = Tensor::from_vec(weights.shape(), weights.data().iter().map(|w| factor * w.powi(power)).collect());
        let tape = Tape::new();
        let v = leaves.clone().map(|x| tape.leaf(x));
        let pair = pair_of(&v, &weights, options);
        [planar(&pair, options), axial(&pair, options), tangential(&pair, options), radial(&pair, options)]
            .iter()
            .flat_map(|term| term.per_image.value().to_vec())
            .collect()
    };
    for options in presets() {
        for ((one, two), other) in under(1.0, 1, &options).iter().zip(under(2.0, 1, &options)).zip(under(1.0, 3, &options)) {
            assert!((one - two).abs() < 1e-12 * (1.0 + one.abs()), "{options:?}: {one} {two}");
            assert!((one - other).abs() > 1e-6 * one.abs(), "{options:?}: {one} {other}");
        }
    }
}

#[test]
fn detached_depth_and_direction_receive_no_gradient() {
    // As printed a = t, and the planar flow reads a_z alone: a_x and a_y reach L_pla by the direction only.
    let base = LossOptions { convention: Convention::AsPrinted, ..pixels() };
    let leaves = perturbed(motions([-0.5, 0.5]));
    // Of L_pla and L_axi, each by source depth and translation.
    let gradients = |detach_source_depth: bool, detach_direction: bool| {
        let options = LossOptions { detach_source_depth, detach_direction, ..base };
        let tape = Tape::new();
        let v = leaves.clone().map(|x| tape.leaf(x));
        let [pla, axi, ..] = all(&v, &options);
        [pla.mean, axi.mean].map(|mean| {
            let grads = tape.backward(mean);
            [grads.wrt(v[1]), grads.wrt(v[4])]
        })
    };
    let free = gradients(false, false);
    for ([free, _], [cut, _]) in free.iter().zip(&gradients(true, false)) {
        assert!(free.data().iter().any(|&g| g != 0.0));
        assert!(cut.data().iter().all(|&g| g == 0.0));
    }
    let cut = gradients(false, true);
    for n in 0..2 {
        let [free, cut] = [&free, &cut].map(|g| [0, 1, 2].map(|c| g[0][1].at(n, c, 0, 0)));
        assert!(free.iter().all(|g| g.abs() > 0.01), "image {n}: {free:?}");
        assert_eq!(cut[..2], [0.0, 0.0], "image {n}");
        assert!((free[2] - cut[2]).abs() < 1e-12, "image {n}: {free:?} {cut:?}");
    }
}

#[test]
fn taped_losses_equal_the_plain_sums() {
    let leaves = perturbed(motions([-0.5, 0.55]));
    let mut compared = [0; 4];
    for options in presets() {
        // Below every radius and flow of this scene, so that the masked forms count all pixels.
        let options = LossOptions { q_min: 0.1, tau_flow: 0.02, ..options };
        let found = values(&leaves, &options);
        let tape = Tape::new();
        let v = leaves.clone().map(|x| tape.leaf(x));
        let pair = pair_of(&v, &masks::everywhere(shape(1)), &options);
        #[allow(clippy::needless_range_loop)] // the sample indexes several lists
        for n in 0..2 {
            let expected = plain(&pair, &options, n);
            for (term, expected) in expected.into_iter().enumerate() {
                let Some(expected) = expected else { continue };
                let x = found[term][n];
                assert!((x - expected).abs() < 1e-9 * (1.0 + expected), "term {term}, {options:?}: {x} {expected}");
                compared[term] += 1;
            }
        }
    }
    // Two images; all five planar forms, four axial, two tangential, two radial.
    assert!(compared.iter().zip([10, 8, 4, 4]).all(|(&c, least)| c >= least), "{compared:?}");
}

/// The same losses by the plain functions; `None` where thresholds make the robust form differ.
fn plain(pair: &AlignedPair<'_, f64>, options: &LossOptions, n: usize) -> [Option<f64>; 4] {
    let k = cameras()[n];
    let (pla, axi) = (pair.planar_flow.value(), pair.axial_flow.value());
    let z = pair.target_depth.value().plane(n, 0).to_vec();
    let a = Vector3::from_fn(|i, _| pair.translation.value().at(n, i, 0, 0));
    let list =
        |t: &Tensor<f64>| -> Vec<Vector2<f64>> { (0..H * W).map(|i| Vector2::new(t.plane(n, 0)[i], t.plane(n, 1)[i])).collect() };
    let (pla, axi) = (list(&pla), list(&axi));
    let d: Vec<_> = (0..H * W).map(|i| Vector2::new((i % W) as f64, (i / W) as f64) - k.principal_point()).collect();
    let direction = Vector2::new(k.fu * a.x, k.fv * a.y);
    let tip = |x: f64| x.hypot(options.smooth_pixels) - options.smooth_pixels;
    let soft = |x: &dyn Fn(usize) -> f64| {
        let kept: Vec<f64> = (0..H * W).filter(|&i| direction.norm() > options.min_tangential_flow * z[i]).map(x).collect();
        kept.iter().map(|&x| tip(x)).sum::<f64>() / kept.len() as f64
    };
    let noisy = options.noise_pixels > 0.0;
    let planar = match options.planar {
        PlanarForm::Literal | PlanarForm::Robust => loss_forms::planar::printed(&pla),
        PlanarForm::Circular => loss_forms::planar::circular(&pla),
        PlanarForm::Weighted => loss_forms::planar::weighted(&pla),
        PlanarForm::PerpendicularPixels => soft(&|i| pla[i].perp(&direction.normalize())),
    };
    let short = |f: &[Vector2<f64>]| f.iter().any(|f| f.norm() <= options.tau_flow);
    let near = d.iter().any(|d| d.norm() < options.q_min);
    let planar =
        (matches!(options.planar, PlanarForm::Literal | PlanarForm::PerpendicularPixels) || !short(&pla)).then_some(planar);
    let axial = match options.axial {
        AxialForm::Literal => Some(loss_forms::axial::printed(&axi, &d)),
        AxialForm::Signed if !near && !short(&axi) => Some(loss_forms::axial::printed(&axi, &d)),
        AxialForm::Folded if !near && !short(&axi) => Some(loss_forms::axial::folded(&axi, &d)),
        AxialForm::PoseSign if !near && !short(&axi) => Some(loss_forms::axial::pose_sign(&axi, &d, a.z)),
        _ => None,
    };
    let tangential = match options.tangential {
        TangentialForm::Literal => Some(loss_forms::tangential::printed(&k, &pla, &z, &a)),
        TangentialForm::InverseRatio => Some(loss_forms::tangential::inverse_ratio(&k, &pla, &z, &a)),
        _ => None,
    };
    let radial = match options.radial {
        RadialForm::Literal => Some(loss_forms::radial::printed(&axi, &d, &z, &a)),
        RadialForm::InverseRatio if !near => Some(loss_forms::radial::inverse_ratio(&axi, &d, &z, &a)),
        _ => None,
    };
    // Pixel forms with noise: `noise_comes_off_the_residual_of_every_pixel`.
    [planar.filter(|_| !noisy), axial, tangential, radial]
}

#[test]
fn pixel_forms_equal_the_plain_sums() {
    let options = LossOptions { min_tangential_flow: 0.0, q_min: 0.0, ..pixels() };
    let leaves = perturbed(motions([-0.5, 0.55]));
    let found = values(&leaves, &options);
    let tape = Tape::new();
    let v = leaves.clone().map(|x| tape.leaf(x));
    let pair = pair_of(&v, &masks::everywhere(shape(1)), &options);
    #[allow(clippy::needless_range_loop)] // the sample indexes several lists
    for n in 0..2 {
        let k = cameras()[n];
        let list = |t: Tensor<f64>| -> Vec<Vector2<f64>> {
            (0..H * W).map(|i| Vector2::new(t.plane(n, 0)[i], t.plane(n, 1)[i])).collect()
        };
        let (pla, axi) = (list(pair.planar_flow.value()), list(pair.axial_flow.value()));
        let z = leaves[0].plane(n, 0);
        let a = Vector3::from_fn(|i, _| pair.translation.value().at(n, i, 0, 0));
        let d: Vec<_> = (0..H * W).map(|i| Vector2::new((i % W) as f64, (i / W) as f64) - k.principal_point()).collect();
        let expected = [
            loss_forms::planar::perpendicular(&pla, &Vector2::new(k.fu * a.x, k.fv * a.y)),
            loss_forms::axial::perpendicular(&axi, &d),
            loss_forms::tangential::flow_pixels(&k, &pla, z, &a),
            loss_forms::radial::flow_pixels(&axi, &d, z, &a),
        ];
        for (term, expected) in expected.into_iter().enumerate() {
            assert!((found[term][n] - expected).abs() < 1e-12, "term {term}: {} {expected}", found[term][n]);
        }
    }
}

#[test]
fn noise_comes_off_the_residual_of_every_pixel() {
    let free = LossOptions { min_tangential_flow: 0.0, q_min: 0.0, ..pixels() };
    let noisy = LossOptions { noise_pixels: 0.05, noise_share: 0.1, ..free };
    let leaves = perturbed(motions([-0.5, 0.55]));
    let (mut within, mut beyond) = ([0; 4], [0; 4]);
    for i in 0..H * W {
        let only = Tensor::from_fn(shape(1), |_, _, v, u| f64::from(u8::from(v * W + u == i)));
        let residuals = |options: &LossOptions| {
            let tape = Tape::new();
            let v = leaves.clone().map(|x| tape.leaf(x));
            let pair = pair_of(&v, &only, options);
            let terms = [planar(&pair, options), axial(&pair, options), tangential(&pair, options), radial(&pair, options)];
            terms.map(|t| t.per_image.value().to_vec())
        };
        let (free, noisy) = (residuals(&free), residuals(&noisy));
        for n in 0..2 {
            let noise = 0.05 + 0.1 * leaves[2].plane(n, 0)[i].hypot(leaves[2].plane(n, 1)[i]);
            for term in 0..4 {
                let expected = (free[term][n] - noise).max(0.0);
                assert!((noisy[term][n] - expected).abs() < 1e-12, "term {term}, pixel {i}: {} {expected}", noisy[term][n]);
                let count = if expected > 0.0 { &mut beyond } else { &mut within };
                count[term] += 1;
            }
        }
    }
    assert!(within.iter().chain(&beyond).all(|&c| c >= 10), "{within:?} {beyond:?}");
}

#[test]
fn hazards_stay_finite() {
    // No motion at all, a pixel behind the camera, one exactly on the principal point, an empty mask.
    let mut camera = cameras()[0];
    (camera.u0, camera.v0) = (6.0, 4.0);
    let depth = Tensor::from_fn(Shape::new(1, 1, H, W), |_, _, v, u| if (v, u) == (2, 3) { -1.0 } else { 5.0 });
    for (options, empty) in presets().into_iter().flat_map(|o| [(o, false), (o, true)]) {
        let tape = Tape::new();
        let zeros = |c| Tensor::zeros(Shape::new(1, c, H, W));
        let vector = || Tensor::zeros(Shape::new(1, 3, 1, 1));
        let v = [depth.clone(), depth.clone(), zeros(2), vector(), vector()].map(|x: Tensor<f64>| tape.leaf(x));
        let mask = if empty { zeros(1) } else { masks::everywhere(depth.shape()) };
        let inputs = PairInputs {
            target_depth: v[0],
            source_depth: v[1],
            flow: v[2],
            rotation: so3_exp(v[3]),
            translation: v[4],
            intrinsics: &[camera],
            mask: &mask,
        };
        let pair = AlignedPair::new(&inputs, &options);
        let terms = [planar(&pair, &options), axial(&pair, &options), tangential(&pair, &options), radial(&pair, &options)];
        for (i, term) in terms.iter().enumerate() {
            assert!(term.mean.value().item().is_finite(), "term {i} {options:?}");
            let grads = tape.backward(term.mean);
            for (k, x) in v.iter().enumerate() {
                assert!(grads.wrt(*x).is_finite(), "term {i}, input {k}, {options:?}");
            }
        }
    }
}

#[test]
fn flow_that_leaves_the_view_is_dropped() {
    let [z, d, f, w, t] = exact(motions([-0.5, -0.4]));
    let tape = Tape::new();
    let flow = Tensor::from_fn(f.shape(), |n, c, v, u| if c == 0 && u == 0 { -1.0 } else { 0.3 * f.at(n, c, v, u) });
    let v = [z, d, flow.clone(), w, t].map(|x| tape.leaf(x));
    let mask = masks::everywhere(shape(1));
    let inputs = PairInputs {
        target_depth: v[0],
        source_depth: v[1],
        flow: v[2],
        rotation: so3_exp(v[3]),
        translation: v[4],
        intrinsics: &cameras(),
        mask: &mask,
    };
    let pair = AlignedPair::new(&inputs, &LossOptions::default());
    let view = masks::in_view(&flow);
    assert!(pair.mask.data().iter().zip(view.data()).all(|(m, v)| m <= v));
    assert!((0..H).all(|v| pair.mask.at(0, 0, v, 0) == 0.0));
}

#[test]
fn planar_pixels_leave_out_images_with_little_tangential_motion() {
    let leaves = perturbed(motions([-0.5, 0.55]));
    let tape = Tape::new();
    let v = leaves.clone().map(|x| tape.leaf(x));
    let base = LossOptions { min_tangential_flow: 0.0, ..pixels() };
    let pair = pair_of(&v, &masks::everywhere(shape(1)), &base);
    let a = pair.translation.value();
    let share = |n: usize| {
        let [x, y, z] = [0, 1, 2].map(|c| a.at(n, c, 0, 0));
        x.hypot(y) / x.hypot(y).hypot(z)
    };
    let shares: Vec<f64> = (0..2).map(share).collect();
    let counts = |limit: f64| {
        let options = LossOptions { min_tangential_share: limit, ..base };
        planar(&pair, &options).counts.iter().map(|&c| c > 0).collect::<Vec<_>>()
    };
    assert_eq!(counts(0.0), [true, true]);
    for limit in [0.999 * shares[0], 1.001 * shares[0], 0.999 * shares[1], 1.001 * shares[1]] {
        assert_eq!(counts(limit), shares.iter().map(|&s| s >= limit).collect::<Vec<_>>(), "{shares:?} {limit}");
    }
}
