//! Losses of optical flow.

use dimode::losses::census::{CensusForm, census};
use dimode::losses::charbonnier::charbonnier;
use dimode::losses::flow_data::{FlowDataTerm, Visibility, flow_data};
use dimode::losses::flow_smoothness::{FlowSmoothness, flow_smoothness};
use dimode::losses::forward_backward::{deviation, forward_backward};
use dimode::losses::occluded_photometric::occluded_photometric;
use dimode::losses::raft_sequence::{raft_sequence, raft_sequence_with};
use dimode_autodiff::gradcheck::random;
use dimode_autodiff::{GradCheck, Scalar, Tape, Tensor, Var};

use crate::scenes::{H, W, between_pixels, cameras, facing_the_source, images, maps, mask, motion, seen, shifted};
use crate::support::{
    Loss, Scene, assert_finite, assert_gradient, assert_nothing, assert_order_free, assert_order_free_to, assert_silent,
    gradients, map, value,
};

const CHECK: GradCheck = GradCheck { step: 1e-6, rtol: 1e-5, atol: 1e-8, allow_zero: false };

/// Of two images under a mask.
#[derive(Clone, Copy, Debug)]
enum Masked {
    Census(CensusForm),
    Occluded,
}

const MASKED: [Masked; 5] = [
    Masked::Census(CensusForm::ArFlow),
    Masked::Census(CensusForm::Smurf),
    Masked::Census(CensusForm::UnFlow { radius: 1 }),
    Masked::Census(CensusForm::UnFlow { radius: 2 }),
    Masked::Occluded,
];

impl Masked {
    /// Cells around a pixel that its error reads.
    fn radius(self) -> usize {
        match self {
            Masked::Census(form) => form.radius(),
            Masked::Occluded => 0,
        }
    }
}

impl Loss for Masked {
    fn of<'t, T: Scalar>(&self, v: &[Var<'t, T>], scene: &Scene) -> Var<'t, T> {
        match *self {
            Masked::Census(form) => census(v[0], v[1], &scene.data(0), form),
            Masked::Occluded => occluded_photometric(v[0], v[1], &scene.data(0)),
        }
    }
}

/// Images of 9 x 11 pixels, so that windows of seven have an inside; the last one is masked altogether.
fn masked(seed: u64) -> Scene {
    let shape = dimode_autodiff::Shape::new(3, 3, 9, 11);
    let image = |seed| random::<f64>(seed, shape, 0.40, 0.43);
    let used = Tensor::from_fn(shape.with_c(1), |n, _, h, w| f64::from(u8::from(n < 2 && w < 6 && (h + w) % 5 != 2)));
    Scene { leaves: vec![image(seed), image(seed + 1)], data: vec![used], cameras: vec![] }
}

#[test]
fn errors_under_a_mask_have_right_gradients() {
    for form in MASKED {
        for seed in [10, 20] {
            assert_gradient(&form, &masked(seed), CHECK);
            assert_order_free(&form, &masked(seed));
        }
    }
}

#[test]
fn errors_under_a_mask_are_finite_at_equal_flat_and_wild_images() {
    for form in MASKED {
        let equal = Scene { leaves: vec![masked(30).leaves[0].clone(); 2], ..masked(30) };
        for scene in [
            equal,
            masked(30).scaled(&[0, 1], 0.0),
            masked(30).scaled(&[1], 0.0),
            masked(30).with_leaf(0, |_, _, _, h, w| ((h + w) % 2) as f64),
            masked(30).scaled(&[0], 1e4),
        ] {
            assert_finite(&form, &scene);
            assert_nothing(&form, &scene.with_data(0, Tensor::zeros(masked(30).data[0].shape())));
        }
    }
}

#[test]
fn masked_pixels_are_silent_whatever_stands_there() {
    for form in MASKED {
        // What is read: the pixels of the mask (without the frame) and their windows.
        let (scene, r) = (masked(40), form.radius());
        let given = &scene.data[0];
        let s = given.shape();
        let counts =
            |n: usize, h: usize, w: usize| h >= r && w >= r && h + r < s.h() && w + r < s.w() && given.at(n, 0, h, w) != 0.0;
        let read = Tensor::from_fn(s, |n, _, h, w| {
            let near = |i: usize, size: usize| i.saturating_sub(r)..(i + r + 1).min(size);
            let any = near(h, s.h()).any(|i| near(w, s.w()).any(|j| counts(n, i, j)));
            f64::from(u8::from(any))
        });
        assert!(read.data().contains(&0.0));
        assert_silent(&form, &scene, &[Some(read.clone()), Some(read)]);
    }
}

/// Which pixels are compared.
#[derive(Clone, Copy, Debug)]
enum Seen {
    InView,
    ForwardBackward,
    Reached,
    ReachedSoftly,
}

/// Of two successive flows; the images, the flow back and the weight of the smoothness are data.
#[derive(Clone, Copy, Debug)]
struct Sequence(FlowDataTerm, Seen);

const SEQUENCES: [Sequence; 9] = [
    Sequence(FlowDataTerm::Photometric, Seen::InView),
    Sequence(FlowDataTerm::Photometric, Seen::ForwardBackward),
    Sequence(FlowDataTerm::Photometric, Seen::Reached),
    Sequence(FlowDataTerm::Photometric, Seen::ReachedSoftly),
    Sequence(FlowDataTerm::Occluded, Seen::InView),
    Sequence(FlowDataTerm::Occluded, Seen::ReachedSoftly),
    Sequence(FlowDataTerm::Census(CensusForm::ArFlow), Seen::InView),
    Sequence(FlowDataTerm::Census(CensusForm::Smurf), Seen::ReachedSoftly),
    Sequence(FlowDataTerm::Census(CensusForm::UnFlow { radius: 1 }), Seen::ForwardBackward),
];

impl Loss for Sequence {
    fn of<'t, T: Scalar>(&self, v: &[Var<'t, T>], scene: &Scene) -> Var<'t, T> {
        let tape = v[0].tape();
        let back = scene.data(2);
        let visible = match self.1 {
            Seen::InView => Visibility::InView,
            Seen::ForwardBackward => Visibility::ForwardBackward(&back),
            Seen::Reached => Visibility::Reached(&back, 0.75),
            Seen::ReachedSoftly => Visibility::ReachedSoftly(&back),
        };
        let images = [0, 1].map(|k| tape.constant(scene.data(k)));
        let smoothness = (FlowSmoothness::Second { edge: 10.0 }, scene.data[3].item());
        flow_data(self.0, v, images, smoothness, visible)
    }
}

/// A shift with errors; some flows leave the view.
fn shifting(seed: u64) -> Scene {
    let shift =
        |u: f64, v: f64, size: f64, seed: u64| shifted(&Tensor::from_fn(maps(3).with_c(2), |_, c, _, _| [u, v][c]), seed, size);
    let flow = |seed| between_pixels(&shift(0.9, -0.5, 0.3, seed));
    let data = vec![images(3, seed), images(3, seed + 1), shift(-0.9, 0.5, 0.2, seed + 2), Tensor::scalar(0.1)];
    Scene { leaves: vec![flow(seed + 3), flow(seed + 4)], data, cameras: vec![] }
}

#[test]
fn every_comparison_of_warped_images_obeys_the_laws() {
    for form in SEQUENCES {
        for seed in [50, 60] {
            assert_gradient(&form, &shifting(seed), CHECK);
        }
        // Divides by the mean of the weights of all images.
        let pooled = matches!(form, Sequence(FlowDataTerm::Occluded, Seen::ReachedSoftly));
        assert_order_free_to(if pooled { 1e-12 } else { 0.0 }, &form, &shifting(50));
        for scene in [
            shifting(70).scaled(&[0, 1], 0.0),
            shifting(70).scaled(&[0, 1], 1e3),
            shifting(70).with_leaf(0, |f, n, _, _, _| if n == 1 { 50.0 } else { f }),
        ] {
            assert_finite(&form, &scene);
        }
        // Without a visible pixel and without smoothness nothing is left.
        assert_nothing(&form, &shifting(70).scaled(&[0, 1], 1e3).with_data(3, Tensor::scalar(0.0)));
    }
}

#[test]
fn pixels_that_leave_the_view_have_no_photometric_gradient() {
    let scene = shifting(80).with_data(3, Tensor::scalar(0.0));
    let scene = scene.with_leaf(1, |f, _, c, h, _| if h == 2 && c == 0 { 30.0 } else { f });
    let (_, grads) = gradients::<f64>(&Sequence(FlowDataTerm::Photometric, Seen::InView), &scene);
    // The reading is clamped along the row only: along the column neighbours' windows see it, but not from two rows on.
    for n in 0..3 {
        assert!((0..W).all(|w| grads[1].at(n, 0, 2, w) == 0.0));
        assert!((0..W).any(|w| grads[1].at(n, 0, 4, w) != 0.0));
    }
}

/// Of a flow under an image.
#[derive(Clone, Copy, Debug)]
struct Smooth(FlowSmoothness);

impl Loss for Smooth {
    fn of<'t, T: Scalar>(&self, v: &[Var<'t, T>], scene: &Scene) -> Var<'t, T> {
        flow_smoothness(v[0], &scene.data(0), self.0)
    }
}

#[test]
fn smoothness_of_flows_obeys_the_laws() {
    for form in [
        FlowSmoothness::Length,
        FlowSmoothness::First { edge: 150.0 },
        FlowSmoothness::Second { edge: 10.0 },
        FlowSmoothness::SecondWide { edge: 150.0 },
    ] {
        let scene = |seed| Scene { leaves: vec![shifting(seed).leaves[0].clone()], data: vec![images(3, seed)], cameras: vec![] };
        for seed in [90, 100] {
            assert_gradient(&Smooth(form), &scene(seed), CHECK);
            assert_order_free(&Smooth(form), &scene(seed));
        }
        // No flow, one flow, and a single pixel that moves.
        assert_finite(&Smooth(form), &scene(90).scaled(&[0], 0.0));
        assert_finite(&Smooth(form), &scene(90).with_leaf(0, |_, _, c, _, _| [0.7, 0.0][c]));
        assert_finite(&Smooth(form), &scene(90).with_leaf(0, |_, _, c, h, w| if (c, h, w) == (1, 3, 3) { 2.0 } else { 0.0 }));
        assert_finite(&Smooth(form), &scene(90).scaled(&[0], 1e4));
    }
}

/// Of a flow and one back.
#[derive(Debug)]
struct There;

impl Loss for There {
    fn of<'t, T: Scalar>(&self, v: &[Var<'t, T>], _: &Scene) -> Var<'t, T> {
        forward_backward(v[0], v[1])
    }
}

#[test]
fn following_a_flow_there_and_back_obeys_the_laws() {
    let scene = |seed| Scene {
        leaves: vec![shifting(seed).leaves[0].clone(), shifting(seed).data[2].clone()],
        data: vec![],
        cameras: vec![],
    };
    for seed in [110, 120] {
        assert_gradient(&There, &scene(seed), CHECK);
        assert_order_free(&There, &scene(seed));
    }
    assert_finite(&There, &scene(110).scaled(&[0, 1], 0.0));
    assert_finite(&There, &scene(110).scaled(&[0], 1e3));
    assert_finite(&There, &scene(110).with_leaf(0, |_, _, c, _, _| [1.0, 0.0][c]).with_leaf(1, |_, _, c, _, _| [-1.0, 0.0][c]));
}

#[test]
fn flows_of_a_wall_there_and_back_cancel() {
    // A wall that faces both cameras: flows are affine in the pixel, so reading between pixels is exact.
    let motions: Vec<_> = [[0.4, 0.2, -0.8], [0.3, -0.3, 0.7], [-0.2, 0.2, -0.9]].map(|t| motion([0.0; 3], t)).to_vec();
    let back: Vec<_> = motions.iter().map(|m| m.inverse()).collect();
    let depth = facing_the_source(5.0, &motions, &cameras());
    let [forward, _] = seen(&depth, &motions, &cameras());
    let [backward, _] = seen(&Tensor::full(maps(3), 5.0), &back, &cameras());
    let tape = Tape::<f64>::new();
    let rest = deviation(tape.constant(forward.clone()), tape.constant(backward)).value();
    let view = dimode_geometry::taped::masks::in_view(&forward);
    let inside = (0..3 * H * W).filter(|&i| view.data()[i] != 0.0).inspect(|&i| assert!(rest.data()[i] < 1e-13)).count();
    assert!(inside > 60, "{inside}");
}

/// Of two predictions; data are the truth and where it is valid.
#[derive(Clone, Copy, Debug)]
struct Supervised(f64);

impl Loss for Supervised {
    fn of<'t, T: Scalar>(&self, v: &[Var<'t, T>], scene: &Scene) -> Var<'t, T> {
        let (truth, valid) = (scene.data(0), scene.data(1));
        if self.0 == 0.8 { raft_sequence(v, &truth, &valid) } else { raft_sequence_with(v, &truth, &valid, self.0) }
    }
}

#[test]
fn supervised_flow_obeys_the_laws() {
    let used = mask(3, |n, h, w| n < 2 && (h * w) % 3 != 1 && (n, h, w) != (1, 5, 0));
    let scene = |seed| {
        // One displacement is too large, though valid.
        let truth = shifting(seed).with_leaf(0, |f, n, c, h, w| match (n, c, h, w) {
            (1, 0, 5, 0) => 500.0,
            (0, _, 0, 1) => f64::NAN,
            _ => f,
        });
        let valid = mask(3, |n, h, w| n < 2 && (h * w) % 3 != 1);
        let valid = Tensor::from_fn(maps(3), |n, _, h, w| if (n, h, w) == (0, 0, 1) { 0.0 } else { valid.at(n, 0, h, w) });
        Scene { leaves: shifting(seed + 5).leaves, data: vec![truth.leaves[0].clone(), valid], cameras: vec![] }
    };
    let used = Tensor::from_fn(maps(3), |n, _, h, w| if (n, h, w) == (0, 0, 1) { 0.0 } else { used.at(n, 0, h, w) });
    for form in [Supervised(0.8), Supervised(0.85)] {
        assert_order_free(&form, &scene(130));
        assert_silent(&form, &scene(130), &[Some(used.clone()), Some(used.clone())]);
        let known = map(&scene(130).data[0], |x| if x.is_nan() { 0.0 } else { x });
        assert_gradient(&form, &scene(130).with_data(0, known.clone()), CHECK);
        assert_finite(&form, &scene(130).scaled(&[0, 1], 0.0));
        let exact = Scene { leaves: vec![known.clone(), known.clone()], ..scene(130) };
        assert!(value(&form, &exact) == 0.0);
        assert_finite(&form, &exact);
        assert_nothing(&form, &scene(130).with_data(1, Tensor::zeros(maps(3))));
    }
}

/// The sum of a penalty.
#[derive(Debug)]
struct Penalty(f64, f64);

impl Loss for Penalty {
    fn of<'t, T: Scalar>(&self, v: &[Var<'t, T>], _: &Scene) -> Var<'t, T> {
        charbonnier(v[0], self.0, self.1).mean()
    }
}

#[test]
fn the_penalty_obeys_the_laws_also_at_zero() {
    for form in [Penalty(1e-3, 0.5), Penalty(1e-3, 0.45)] {
        let scene = Scene { leaves: vec![random(140, maps(2), -1.0, 1.0)], data: vec![], cameras: vec![] };
        assert_gradient(&form, &scene, CHECK);
        assert_order_free(&form, &scene);
        assert_finite(&form, &scene.scaled(&[0], 0.0));
        assert_finite(&form, &scene.scaled(&[0], 1e6));
    }
}
