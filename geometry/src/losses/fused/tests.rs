//! The fused losses against the composed ones, differences and themselves on several threads.

use dimode_autodiff::gradcheck::{random, weighted_sum};
use dimode_autodiff::{GradCheck, Scalar, Shape, Tape, Tensor, Var, gradcheck, par};

use super::geometric_losses;
use crate::alignment::Convention;
use crate::camera::Intrinsics;
use crate::losses::{
    AlignedPair, AxialForm, LossOptions, LossTerm, PairInputs, PlanarForm, RadialForm, TangentialForm, axial, planar, radial,
    tangential,
};
use crate::taped::pose::pose_tensors;
use crate::taped::{masks, rigid_flow};
use crate::{Se3, so3};

/// Target depth, source depth, rotation vector, translation, flow; then cameras and mask.
#[derive(Clone)]
struct Case {
    leaves: [Tensor<f64>; 5],
    cameras: Vec<Intrinsics>,
    mask: Tensor<f64>,
}

const ALL: [bool; 4] = [true; 4];

impl Case {
    /// A static scene with errors everywhere; some flows leave the view.
    fn new(seed: u64, n: usize, h: usize, w: usize) -> Self {
        let shape = Shape::new(n, 1, h, w);
        let camera = |i: usize| {
            let (u0, v0) = (0.47 * w as f64 + 0.3 * i as f64, 0.52 * h as f64);
            Intrinsics::new(20.0 + i as f64, 21.0 - i as f64, u0, v0, w, h).unwrap()
        };
        let cameras: Vec<_> = (0..n).map(camera).collect();
        let draw = random::<f64>(seed, Shape::new(n, 6, 1, 1), -1.0, 1.0);
        let sign = |i: usize| if (seed as usize + i).is_multiple_of(2) { -1.0 } else { 1.0 };
        let motion = |i: usize| {
            let [a, b, c, d, e, f] = std::array::from_fn(|k| draw.at(i, k, 0, 0));
            let t = [0.3 + 0.1 * a, -0.25 + 0.1 * b, sign(i) * (0.45 + 0.1 * c)];
            Se3::from_rotation_vector(&[0.03 * d, 0.03 * e, 0.03 * f].into(), t.into())
        };
        let motions: Vec<_> = (0..n).map(motion).collect();
        let tape = Tape::new();
        let depth = random(seed + 1, shape, 3.0, 8.0);
        let (r, t) = pose_tensors(&motions);
        let rigid = rigid_flow(tape.constant(depth.clone()), tape.constant(r), tape.constant(t.clone()), &cameras).value();
        let noise = random::<f64>(seed + 2, shape.with_c(2), 0.8, 1.2);
        let flow = Tensor::from_fn(shape.with_c(2), |n, c, v, u| rigid.at(n, c, v, u) * noise.at(n, c, v, u));
        let w = Tensor::from_fn(Shape::new(n, 3, 1, 1), |n, i, _, _| 1.1 * so3::log(&motions[n].rotation)[i]);
        let source = random(seed + 3, shape, 3.0, 8.0);
        Self { leaves: [depth, source, w, t, flow], cameras, mask: masks::everywhere(shape) }
    }

    fn shape(&self) -> Shape {
        self.leaves[0].shape()
    }

    /// The same with another value of leaf `k` where `at` says so.
    fn with(mut self, k: usize, at: impl Fn([usize; 4]) -> Option<f64>) -> Self {
        let old = self.leaves[k].clone();
        self.leaves[k] = Tensor::from_fn(old.shape(), |n, c, v, u| at([n, c, v, u]).unwrap_or(old.at(n, c, v, u)));
        self
    }

    fn masked(mut self, mask: impl Fn(usize, usize, usize) -> f64) -> Self {
        self.mask = Tensor::from_fn(self.shape(), |n, _, v, u| mask(n, v, u));
        self
    }

    fn inputs<'a, 't, T: Scalar>(&'a self, v: &[Var<'t, T>], mask: &'a Tensor<T>) -> PairInputs<'a, 't, T> {
        PairInputs {
            target_depth: v[0],
            source_depth: v[1],
            flow: v[4],
            rotation: crate::taped::so3_exp(v[2]),
            translation: v[3],
            intrinsics: &self.cameras,
            mask,
        }
    }
}

fn composed<'t, T: Scalar>(inputs: &PairInputs<'_, 't, T>, options: &LossOptions) -> [LossTerm<'t, T>; 4] {
    let pair = AlignedPair::new(inputs, options);
    [planar(&pair, options), axial(&pair, options), tangential(&pair, options), radial(&pair, options)]
}

fn fused<'t, T: Scalar>(inputs: &PairInputs<'_, 't, T>, options: &LossOptions) -> [LossTerm<'t, T>; 4] {
    geometric_losses(inputs, options, ALL).expect("forms with kernels")
}

/// Forms in pixels of every image and of every residual.
fn pixels() -> LossOptions {
    let free = LossOptions { min_tangential_share: 0.0, noise_pixels: 0.0, noise_share: 0.0, ..LossOptions::default() };
    LossOptions { min_tangential_flow: 0.2, detach_source_depth: false, ..free }
}

/// Forms and settings with kernels.
fn presets() -> Vec<LossOptions> {
    let literal = LossOptions::literal();
    vec![
        literal,
        LossOptions { convention: Convention::Consistent, axes: [true, false, true], ..literal },
        LossOptions { axes: [false, true, false], ..literal },
        LossOptions::default(),
        pixels(),
        LossOptions { smooth_pixels: 0.3, detach_direction: true, q_min: 2.5, ..pixels() },
        LossOptions { noise_pixels: 0.02, noise_share: 0.03, smooth_pixels: 0.1, z_min: 3.5, ..pixels() },
        LossOptions { noise_share: 0.05, min_tangential_share: 0.6, min_tangential_flow: 1.2, ..pixels() },
        LossOptions { planar: PlanarForm::Literal, radial: RadialForm::Literal, min_valid_share: 0.6, ..pixels() },
    ]
}

/// Values, numbers of pixels, means and the gradients of four losses, one after another.
struct Found {
    values: Vec<f64>,
    counts: Vec<Vec<usize>>,
    /// Of each loss's mean and of a mix of all images and losses, to each leaf.
    gradients: Vec<[Tensor<f64>; 5]>,
}

type Losses<T> = for<'t> fn(&PairInputs<'_, 't, T>, &LossOptions) -> [LossTerm<'t, T>; 4];

fn found<T: Scalar>(case: &Case, options: &LossOptions, losses: Losses<T>) -> Found {
    let tape = Tape::<T>::new();
    let v = case.leaves.clone().map(|x| tape.leaf(x.cast::<T>()));
    let mask = case.mask.cast::<T>();
    let terms = losses(&case.inputs(&v, &mask), options);
    let mut values = Vec::new();
    for term in &terms {
        values.extend(term.per_image.value().data().iter().chain(term.mean.value().data()).map(|x| x.to_f64()));
    }
    let mix = (0..4).map(|k| weighted_sum(terms[k].per_image, k as u64 + 1)).reduce(Var::add).unwrap();
    let gradients = terms.iter().map(|term| term.mean).chain([mix]).map(|loss| {
        let grads = tape.backward(loss.add(v[0].sum().scale(0.0)));
        v.map(|v| grads.get(v).map_or_else(|| Tensor::zeros(v.shape()), |g| g.cast::<f64>()))
    });
    Found { values, counts: terms.iter().map(|t| t.counts.clone()).collect(), gradients: gradients.collect() }
}

/// Greatest difference of equal numbers, as a part of 1 plus the number.
const EXACT: f64 = 1e-10;

fn same(a: f64, b: f64) -> bool {
    within(a, b, EXACT)
}

fn within(a: f64, b: f64, tolerance: f64) -> bool {
    (a - b).abs() <= tolerance * (1.0 + b.abs())
}

/// The composed losses with the printed angles by sine and cosine, which is well-conditioned at every angle:
/// `arccos(f_u / |f|) = atan2(|f_v|, f_u)` and `arccos(d . f / (|d| |f|)) = atan2(|d x f|, d . f)`.
fn composed_by_sines<'t, T: Scalar>(inputs: &PairInputs<'_, 't, T>, options: &LossOptions) -> [LossTerm<'t, T>; 4] {
    let pair = AlignedPair::new(inputs, options);
    let everywhere = LossOptions { tau_flow: 0.0, q_min: 0.0, ..*options };
    let planar_loss = match options.planar {
        PlanarForm::Literal => planar(&pair, &LossOptions { planar: PlanarForm::Robust, ..everywhere }),
        _ => planar(&pair, options),
    };
    let axial_loss = match options.axial {
        AxialForm::Literal => axial(&pair, &LossOptions { axial: AxialForm::Signed, ..everywhere }),
        _ => axial(&pair, options),
    };
    [planar_loss, axial_loss, tangential(&pair, options), radial(&pair, options)]
}

/// Asserts equal numbers of pixels, equal values, and gradients that are equal to a tolerance of each.
fn assert_equal(a: &Found, b: &Found, tolerances: [f64; 5], options: &LossOptions) {
    assert_eq!(a.counts, b.counts, "{options:?}");
    for (i, (&a, &b)) in a.values.iter().zip(&b.values).enumerate() {
        assert!(same(a, b), "value {i}: {a} against {b} with {options:?}");
    }
    for (loss, (a, b)) in a.gradients.iter().zip(&b.gradients).enumerate() {
        for (leaf, (a, b)) in a.iter().zip(b).enumerate() {
            for (i, (&a, &b)) in a.data().iter().zip(b.data()).enumerate() {
                assert!(within(a, b, tolerances[loss]), "loss {loss}, leaf {leaf}, entry {i}: {a} against {b} with {options:?}");
            }
        }
    }
}

/// Asserts that the fused losses are the composed ones.
fn assert_composed(case: &Case, options: &LossOptions) -> Found {
    let fused = found::<f64>(case, options, fused);
    assert_equal(&fused, &found::<f64>(case, options, composed_by_sines), [EXACT; 5], options);
    let angles = [options.planar == PlanarForm::Literal, options.axial == AxialForm::Literal];
    if angles.contains(&true) {
        // As printed: near a cosine of 1 the slope `1 / sqrt(1 - c^2)` loses the digits that `1 - c^2` has lost. The
        // fused slope has the sine itself. Away from 1 see `the_printed_angles_are_exact_where_the_arccos_is`.
        let tolerances = [angles[0], angles[1], false, false, true].map(|printed| if printed { 1e-7 } else { EXACT });
        assert_equal(&fused, &found::<f64>(case, options, composed), tolerances, options);
    }
    fused
}

#[test]
fn equal_the_composed_losses_for_any_batch_and_width() {
    let mut pixels = 0;
    for (seed, [n, h, w]) in
        [(1, [1, 11, 37]), (2, [2, 19, 16]), (3, [3, 5, 23]), (4, [1, 9, 2]), (5, [1, 2, 5]), (6, [2, 3, 341])]
    {
        for options in presets() {
            let found = assert_composed(&Case::new(seed, n, h, w), &options);
            pixels += found.counts.iter().flatten().sum::<usize>();
        }
    }
    assert!(pixels > 40_000, "{pixels}");
}

#[test]
fn the_printed_angles_are_exact_where_the_arccos_is() {
    let mut pixels = 0;
    for seed in 8..11 {
        let case = Case::new(seed, 2, 19, 37);
        for options in presets() {
            let tape = Tape::<f64>::new();
            let leaves = case.leaves.clone().map(|x| tape.constant(x));
            let pair = AlignedPair::new(&case.inputs(&leaves, &case.mask), &options);
            let (planar, axial) = (pair.planar_flow.value(), pair.axial_flow.value());
            let steep = |n: usize, v: usize, u: usize| {
                let sine = |[x, y]: [f64; 2], [a, b]: [f64; 2]| ((x * b - y * a) / (x.hypot(y) * a.hypot(b))).abs();
                let flow = |f: &Tensor<f64>| [f.at(n, 0, v, u), f.at(n, 1, v, u)];
                let radius = [u as f64 - case.cameras[n].u0, v as f64 - case.cameras[n].v0];
                sine(flow(&planar), [1.0, 0.0]) > 0.1 && sine(flow(&axial), radius) > 0.1
            };
            let case = case.clone().masked(|n, v, u| f64::from(u8::from(steep(n, v, u))));
            let fused = found::<f64>(&case, &options, fused);
            assert_equal(&fused, &found::<f64>(&case, &options, composed), [EXACT; 5], &options);
            pixels += fused.counts.iter().flatten().sum::<usize>();
        }
    }
    assert!(pixels > 20_000, "{pixels}");
}

#[test]
fn gradients_say_something() {
    let found = assert_composed(&Case::new(7, 2, 11, 37), &pixels());
    for (loss, gradients) in found.gradients.iter().enumerate() {
        for leaf in (0..5).filter(|&leaf| leaf != 0 || loss > 1) {
            let size = gradients[leaf].data().iter().fold(0.0, |m: f64, g| m.max(g.abs()));
            assert!(size > 1e-4, "loss {loss}, leaf {leaf}: {size}");
        }
    }
}

#[test]
fn equal_the_composed_losses_under_weights() {
    for seed in 11..14 {
        let case = Case::new(seed, 2, 11, 37);
        let weights = random::<f64>(seed, case.shape(), 0.0, 1.0);
        let case = case.masked(|n, v, u| if (u + v) % 5 == 0 { 0.0 } else { weights.at(n, 0, v, u) });
        for options in presets() {
            assert_composed(&case, &options);
        }
    }
}

#[test]
fn empty_masks_and_images_without_pixels_cost_nothing() {
    for options in presets() {
        assert_composed(&Case::new(21, 2, 11, 37).masked(|n, _, _| n as f64), &options);
        let found = assert_composed(&Case::new(21, 2, 11, 37).masked(|_, _, _| 0.0), &options);
        // An aggregate error of nothing recovered is 1.
        assert!(found.counts.iter().flatten().all(|&c| c == 0));
        assert!(
            found
                .gradients
                .iter()
                .flatten()
                .flat_map(|g| g.data())
                .all(|&g| g == 0.0 || options.tangential == TangentialForm::Literal)
        );
    }
}

#[test]
fn points_behind_a_camera_and_flows_out_of_view_are_left_out() {
    for options in presets() {
        let behind = Case::new(31, 2, 11, 37).with(1, |[_, _, v, u]| (u % 4 == 1).then_some(if v % 2 == 0 { -2.0 } else { 0.2 }));
        assert_composed(&behind, &options);
        let target = Case::new(32, 2, 11, 37).with(0, |[_, _, _, u]| (u % 4 == 1).then_some(-1.0));
        assert_composed(&target, &options);
        let away = Case::new(33, 2, 11, 37).with(4, |[_, c, v, _]| (v % 3 == 0).then_some(if c == 0 { 0.1 } else { 50.0 }));
        assert_composed(&away, &options);
    }
}

#[test]
fn exact_zeros_are_as_in_the_composed_losses() {
    for options in presets() {
        // No flow and no rotation on a camera with a pixel on the principal point; some components of the translation 0.
        for t in [[0.0, 0.2, -0.4], [0.3, 0.0, 0.4], [0.2, -0.1, 0.0], [0.0; 3]] {
            let mut case = Case::new(41, 1, 11, 37);
            (case.cameras[0].u0, case.cameras[0].v0) = (17.0, 5.0);
            let case = case.with(3, |[_, c, ..]| Some(t[c])).with(2, |_| Some(0.0));
            assert_composed(&case, &options);
            assert_composed(&case.clone().with(4, |[_, _, _, u]| (u % 3 == 0).then_some(0.0)), &options);
            let still = case.with(4, |_| Some(0.0));
            let found = found::<f64>(&still, &options, fused);
            assert_eq!(found.counts, self::found::<f64>(&still, &options, composed).counts, "{t:?} {options:?}");
            assert!(found.values.iter().chain(found.gradients.iter().flatten().flat_map(|g| g.data())).all(|x| x.is_finite()));
        }
    }
}

#[test]
fn pixels_that_no_one_uses_may_hold_anything() {
    let unused = |u: usize| u % 4 == 1;
    let base = Case::new(51, 2, 11, 37).masked(|_, _, u| f64::from(u8::from(!unused(u))));
    for options in presets() {
        let expected = found::<f64>(&base, &options, fused);
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.0] {
            for leaf in [0, 4] {
                let spoilt = base.clone().with(leaf, |[_, _, _, u]| unused(u).then_some(bad));
                let found = found::<f64>(&spoilt, &options, fused);
                assert_eq!(found.values, expected.values, "{bad} in leaf {leaf}");
                for (a, b) in found.gradients.iter().flatten().zip(expected.gradients.iter().flatten()) {
                    assert!(a.data() == b.data(), "{bad} in leaf {leaf} with {options:?}");
                }
            }
            // A source depth is read by its neighbours too: the same pixels drop out as in the composed form.
            if !(bad.is_infinite() || bad.is_nan()) {
                continue;
            }
            let spoilt = base.clone().with(1, |[_, _, v, u]| (v == 4 && u == 9).then_some(bad));
            let found = found::<f64>(&spoilt, &options, fused);
            assert_eq!(found.counts, self::found::<f64>(&spoilt, &options, composed).counts, "{bad}");
            assert!(found.gradients.iter().flatten().flat_map(|g| g.data()).all(|g| g.is_finite()), "{bad} with {options:?}");
        }
    }
}

#[test]
fn gradients_match_differences() {
    let case = Case::new(61, 2, 9, 11);
    let settings = GradCheck { step: 1e-7, atol: 1e-6, rtol: 1e-5, ..GradCheck::default() };
    for options in presets() {
        // The printed loss of an axis that does not count has no gradient to compare.
        // All of the noise is more than what some residuals have here.
        let settings = GradCheck { allow_zero: options.noise_pixels == LossOptions::default().noise_pixels, ..settings };
        let losses = (0..4).filter(|&k| k != 3 || options.axes[2] || options.radial == RadialForm::FlowPixels);
        for k in losses {
            let report = gradcheck(
                &case.leaves,
                |_, v| geometric_losses(&case.inputs(v, &case.mask), &undetached(options), ALL).unwrap()[k].mean,
                settings,
            );
            assert!(report.is_ok(), "loss {k} of {options:?}\n{report}");
        }
    }
}

/// What is cut off is not seen by differences.
fn undetached(options: LossOptions) -> LossOptions {
    LossOptions { detach_source_depth: false, detach_direction: false, ..options }
}

#[test]
fn losses_that_are_not_wanted_are_zero_and_do_not_ask_for_a_kernel() {
    let case = Case::new(71, 2, 11, 37);
    let other = LossOptions { planar: PlanarForm::Circular, axial: AxialForm::Folded, ..pixels() };
    let tape = Tape::<f64>::new();
    let v = case.leaves.clone().map(|x| tape.leaf(x));
    let inputs = case.inputs(&v, &case.mask);
    assert!(geometric_losses(&inputs, &other, [false, true, false, false]).is_none());
    let [planar, axial, tangential, radial] = geometric_losses(&inputs, &other, [false, false, true, true]).unwrap();
    let expected = composed(&inputs, &other);
    assert_eq!((planar.counts, axial.counts), (vec![0, 0], vec![0, 0]));
    assert_eq!((planar.mean.value().item(), axial.mean.value().item()), (0.0, 0.0));
    for (a, b) in [(tangential, &expected[2]), (radial, &expected[3])] {
        assert_eq!(a.counts, b.counts);
        assert!(same(a.mean.value().item(), b.mean.value().item()));
    }
}

#[test]
fn same_bits_on_any_number_of_threads() {
    let case = Case::new(81, 2, 67, 341);
    for options in [LossOptions::literal(), pixels()] {
        let bits = || {
            let found = found::<f32>(&case, &options, fused);
            let gradients = found.gradients.iter().flatten().flat_map(|g| g.to_vec());
            found.values.iter().copied().chain(gradients).map(f64::to_bits).collect::<Vec<_>>()
        };
        let one = par::with_threads(1, bits);
        for threads in 2..5 {
            assert!(par::with_threads(threads, bits) == one, "{threads} threads");
        }
    }
}

#[test]
fn single_precision_is_close() {
    let case = Case::new(91, 2, 40, 61);
    for options in [pixels(), LossOptions { noise_pixels: 0.1, noise_share: 0.2, ..pixels() }] {
        let (single, double) = (found::<f32>(&case, &options, fused), found::<f64>(&case, &options, fused));
        for (a, b) in single.values.iter().zip(&double.values) {
            assert!((a - b).abs() < 1e-4 * (1.0 + b.abs()), "{a} {b}");
        }
        for (a, b) in single.gradients.iter().flatten().zip(double.gradients.iter().flatten()) {
            let square = |x: f64| x * x;
            let error: f64 = a.data().iter().zip(b.data()).map(|(a, b)| square(a - b)).sum();
            let size: f64 = b.data().iter().map(|&b| square(b)).sum();
            assert!(error.sqrt() < 1e-2 * size.sqrt() + 1e-9, "{} of {}", error.sqrt(), size.sqrt());
        }
    }
    // The printed angles; the printed ratios hang on a few pixels near a pole.
    let (single, double) =
        (found::<f32>(&case, &LossOptions::literal(), fused), found::<f64>(&case, &LossOptions::literal(), fused));
    for (a, b) in single.values[..6].iter().zip(&double.values[..6]) {
        assert!((a - b).abs() < 1e-4 * (1.0 + b.abs()), "{a} {b}");
    }
}
