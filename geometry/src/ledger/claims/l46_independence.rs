//! L46: which part of the translation each direction loss depends on.

use dimode_autodiff::proof::{Dual, Number};
use dimode_autodiff::{Shape, Tape, Tensor, Var};
use nalgebra::{Matrix3, Vector2, Vector3};

use crate::aligned_scene::AlignedScene;
use crate::alignment::{self, AlignmentJacobian, Convention, Match};
use crate::camera::Intrinsics;
use crate::ledger::forward::{self, V2, direction};
use crate::ledger::{Claim, Findings, Trial, Verdict, taped};
use crate::loss_forms::{axial, planar};
use crate::losses::{self, AlignedPair, AxialForm, LossOptions, PairInputs, PlanarForm};
use crate::scenes::{self, Reference};
use crate::so3;

pub(super) static CLAIM: Claim = Claim {
    id: "L46",
    slug: "independence",
    place: "text after eq. la",
    statement: "L_pla uses the radial translation only and L_axi the tangential one only, so that both are optimised \
                independently.",
    verdict: Verdict::Conditional,
    condition: Some(
        "the translation t' in the target frame is the parameter, and the angle forms are used; both losses still share \
         rotation and source depth",
    ),
    formula: "dL_pla/dt'_x = dL_pla/dt'_y = 0, dL_axi/dt'_z = 0; with t = R t' as the parameter dL_pla/dt = R e_3 dL_pla/dt'_z",
    derivation: "The planar alignment removes (0, 0, t'_z) and looks at nothing else of t', the axial one (t'_x, t'_y, 0). \
                 With t' = R^T t every component of t reaches t'_z: dt'_z/dt = R e_3, whose first two components are of the \
                 size of the rotation angle.",
    counter_example: Some(
        "handheld, with t as the parameter: t_x and t_y get 0.0583 of the radial gradient of L_pla. The form of L_pla that \
         measures the distance from the predicted direction depends on t'_x, t'_y by design.",
    ),
    correction: Some("Let the network predict t', or cut the gradient that passes R^T t to the other part."),
    functions: &[
        "alignment::planar_jacobian",
        "alignment::axial_jacobian",
        "loss_forms::planar::gradients::circular",
        "loss_forms::axial::gradients::smooth",
    ],
    taped: &["taped::translation_in_target_frame", "taped::align", "taped::so3_exp", "losses::planar", "losses::axial"],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    for reference in [scenes::handheld(), scenes::generic(), scenes::turn()] {
        for _ in 0..(trial.samples / 400).max(1) {
            let estimate = Estimate::new(&reference, &std::array::from_fn(|_| trial.draw.unit()));
            at(&estimate, &mut trial.findings);
            trial.count(estimate.matches.len());
        }
    }
    // The true rotation; translation and depths are off, for at the truth there is no gradient.
    let estimate = Estimate::new(&scenes::handheld(), &[0.5, 0.5, 0.5, 0.9, 0.7, 0.2, 0.6, 0.4]);
    at(&estimate, &mut trial.findings);
    trial.count(estimate.matches.len());
    let share = shared(&estimate);
    let tilt = estimate.rotation.column(2).xy().norm();
    trial.findings.documented("handheld: share of t_x, t_y in the radial gradient, documented", tilt, 0.0583, 1e-3);
    trial.findings.gap("handheld: gradient along t_x, t_y over the radial one, t as parameter", share, 0.052);
    let pixel_form =
        taped_gradient(&estimate, Convention::AsPrinted, |pair| planar_form(pair, PlanarForm::PerpendicularPixels)).0;
    let size = Vector3::new(pixel_form[3], pixel_form[4], pixel_form[5]).norm();
    trial.findings.gap(
        "pixel form of L_pla: share of t'_x, t'_y in the gradient",
        pixel_form[3].hypot(pixel_form[4]) / size,
        0.86,
    );
}

/// Every fourth pixel of every fourth row of a reference, and an estimate of its motion that is somewhat off.
struct Estimate {
    camera: Intrinsics,
    matches: Vec<Match>,
    rotation: Matrix3<f64>,
    a: Vector3<f64>,
}

impl Estimate {
    const STEP: usize = 4;

    /// Up to 0.01 rad about each axis, up to 20 % of each component of t', up to 10 % of a depth that varies over the image.
    fn new(reference: &Reference, x: &[f64; 8]) -> Self {
        let centred: [f64; 8] = x.map(|x| 2.0 * x - 1.0);
        let (grid, step) = (reference.scene.grid_camera(), Self::STEP);
        let [width, height] = [grid.width.div_ceil(step), grid.height.div_ceil(step)];
        let scale = step as f64;
        let camera =
            Intrinsics { fu: grid.fu / scale, fv: grid.fv / scale, u0: grid.u0 / scale, v0: grid.v0 / scale, width, height };
        let exact = reference.scene.matches(&reference.motion);
        let pixel = |i: usize| {
            let (column, row) = (i % width, i / width);
            let m = &exact[(row * step) * grid.width + column * step];
            // From a pixel of the scene to one of the thinned image: sixteen times four pixels are one.
            let flow = (m.source - m.target) / (scenes::STEP as f64 * scale);
            let target = Vector2::new(column as f64, row as f64);
            let wave = (0.9 * column as f64 + 1.3 * row as f64 + 3.0 * centred[7]).sin();
            Match { target, source: target + flow, source_depth: m.source_depth * (1.0 + 0.1 * centred[6] * wave) }
        };
        let error = so3::exp(&(Vector3::new(centred[0], centred[1], centred[2]) * 0.01));
        let truth = reference.motion.translation_in_from_frame();
        let a = truth.component_mul(&Vector3::from_fn(|k, _| 1.0 + 0.2 * centred[3 + k]));
        Self { camera, matches: (0..width * height).map(pixel).collect(), rotation: reference.motion.rotation * error, a }
    }

    fn offsets(&self) -> Vec<Vector2<f64>> {
        self.matches.iter().map(|m| m.target - self.camera.principal_point()).collect()
    }
}

type Align = fn(&Intrinsics, &Matrix3<f64>, &Vector3<f64>, &Match) -> Option<alignment::Aligned>;
type Jacobian = fn(&Intrinsics, &Matrix3<f64>, &Vector3<f64>, &Match) -> AlignmentJacobian;

/// Gradient with respect to `eps` in `R exp(eps)` and to `a`: that of the loss with respect to the flows times the derivatives of
/// the flows.
fn closed(
    e: &Estimate,
    align: Align,
    jacobian: Jacobian,
    gradient: impl Fn(&[Vector2<f64>]) -> Vec<Vector2<f64>>,
) -> Option<[f64; 6]> {
    let flows: Vec<_> =
        e.matches.iter().map(|m| align(&e.camera, &e.rotation, &e.a, m).map(|x| x.flow)).collect::<Option<_>>()?;
    let mut total = [0.0; 6];
    for (g, m) in gradient(&flows).iter().zip(&e.matches) {
        let j = jacobian(&e.camera, &e.rotation, &e.a, m);
        for k in 0..3 {
            total[k] += g.dot(&j.rotation.column(k));
            total[3 + k] += g.dot(&j.translation.column(k));
        }
    }
    Some(total)
}

/// Circular planar and smooth axial loss after the errors `(eps, delta)`.
fn forward_losses<N: Number>(e: &Estimate, error: [N; 6]) -> [N; 2] {
    let [w_x, w_y, w_z, x, y, z] = error;
    let a = forward::sum(forward::fixed(e.a.into()), [x, y, z]);
    let rotations = [forward::fixed(so3::log(&e.rotation).into()), [w_x, w_y, w_z]];
    let flows = |removed| -> Vec<V2<N>> {
        let one = |m: &Match| {
            let pixels = [forward::fixed(m.target.into()), forward::fixed(m.source.into())];
            forward::aligned(&e.camera, rotations, removed, pixels, N::constant(m.source_depth)).0
        };
        e.matches.iter().map(one).collect()
    };
    let offsets: Vec<V2<f64>> = e.offsets().iter().map(|&d| d.into()).collect();
    let zero = N::zero();
    [direction::planar_circular(&flows([zero, zero, a[2]])), direction::axial_smooth(&flows([a[0], a[1], zero]), &offsets)]
}

fn planar_form<'t>(pair: &AlignedPair<'t, f64>, form: PlanarForm) -> Var<'t, f64> {
    losses::planar(pair, &LossOptions { planar: form, ..taped::bare() }).mean
}

fn axial_form<'t>(pair: &AlignedPair<'t, f64>, form: AxialForm) -> Var<'t, f64> {
    losses::axial(pair, &LossOptions { axial: form, ..taped::bare() }).mean
}

/// The squared sine, from `(f x d)^2 + (f . d)^2 = f.f d.d`.
fn axial_smooth<'t>(pair: &AlignedPair<'t, f64>) -> Var<'t, f64> {
    let products = pair.axial_products(&pair.mask);
    let across = products.across.square();
    across.div(across.add(products.along.square())).mean()
}

/// Gradients on the tape. `AsPrinted` aligns with the leaf itself, which is then `t'`: the result is that of `eps` and `t'`.
/// `Consistent` takes the leaf for `t` and aligns with `R^T t`. Second: the gradient that arrives at the translation the
/// alignment removes.
fn taped_gradient(
    e: &Estimate,
    convention: Convention,
    loss: impl for<'t> Fn(&AlignedPair<'t, f64>) -> Var<'t, f64>,
) -> ([f64; 6], [f64; 3]) {
    let (h, w) = (e.camera.height, e.camera.width);
    let map = |c: usize, of: &dyn Fn(&Match, usize) -> f64| {
        Tensor::from_fn(Shape::new(1, c, h, w), |_, c, v, u| of(&e.matches[v * w + u], c))
    };
    let tape = Tape::new();
    let translation = if convention == Convention::AsPrinted { e.a } else { e.rotation * e.a };
    let (eps, t) = (tape.leaf(taped::column(&[0.0; 3])), tape.leaf(taped::column(translation.as_slice())));
    let start = tape.constant(Tensor::from_fn(Shape::new(1, 1, 3, 3), |_, _, i, j| e.rotation[(i, j)]));
    let depth = tape.constant(map(1, &|m, _| m.source_depth));
    let inputs = PairInputs {
        target_depth: depth,
        source_depth: depth,
        flow: tape.constant(map(2, &|m, c| m.source[c] - m.target[c])),
        rotation: start.matmul(crate::taped::so3_exp(eps)),
        translation: t,
        intrinsics: &[e.camera],
        mask: &Tensor::full(Shape::new(1, 1, h, w), 1.0),
    };
    let pair = AlignedPair::from_sampled(&inputs, &LossOptions { convention, ..taped::bare() });
    let removed = pair.translation.retain_grad();
    let gradients = tape.backward(loss(&pair));
    let (eps, t, removed) = (gradients.wrt(eps), gradients.wrt(t), gradients.wrt(removed));
    (std::array::from_fn(|k| if k < 3 { eps.data()[k] } else { t.data()[k - 3] }), std::array::from_fn(|k| removed.data()[k]))
}

fn at(e: &Estimate, f: &mut Findings) {
    derivatives(e, f);
    blocks(e, f);
    f.residual("dL_pla/dt - R e_3 dL_pla/dt'_z, relative", misfit(e), 1e-12);
}

/// The rotation, in radians, that would undo the shortest aligned flow: directions turn so fast there that a difference needs
/// far smaller steps.
fn shortest(e: &Estimate) -> Option<f64> {
    let seen = AlignedScene::new(&e.camera, &e.rotation, &e.a, &e.matches)?;
    seen.planar.iter().chain(&seen.axial).map(|f| f.norm() / e.camera.fu).reduce(f64::min)
}

fn derivatives(e: &Estimate, f: &mut Findings) {
    let Some(shortest) = shortest(e) else { return f.residual("scene in front of the camera", f64::NAN, 1.0) };
    // A flow that almost vanishes has no direction to speak of.
    if shortest < 1e-4 {
        return;
    }
    let offsets = e.offsets();
    let pla = closed(e, alignment::planar, alignment::planar_jacobian, planar::gradients::circular);
    let axi = closed(e, alignment::axial, alignment::axial_jacobian, |flows| axial::gradients::smooth(flows, &offsets));
    let (Some(pla), Some(axi)) = (pla, axi) else { return f.residual("scene in front of the camera", f64::NAN, 1.0) };
    let dual = forward::jacobian([0.0; 6], |x: [Dual; 6]| forward_losses(e, x));
    // Steps that turn the shortest flow by some 2e-4 rad: longer ones leave more over, shorter ones drown in rounding. A point
    // moves by its depth times an angle.
    let nearest = e.matches.iter().map(|m| m.source_depth).fold(f64::INFINITY, f64::min);
    let steps = std::array::from_fn(|k| 2e-4 * shortest * if k < 3 { 1.0 } else { nearest });
    let central = forward::central_extrapolated([0.0; 6], steps, |x: [f64; 6]| forward_losses(e, x));
    let by_tape = [
        taped_gradient(e, Convention::AsPrinted, |pair| planar_form(pair, PlanarForm::Circular)).0,
        taped_gradient(e, Convention::AsPrinted, axial_smooth).0,
    ];
    for (i, (name, closed)) in [("circular L_pla", pla), ("squared sine of L_axi", axi)].into_iter().enumerate() {
        let rows = i * 6..i * 6 + 6;
        let scale = closed.iter().fold(0.0f64, |m, x| m.max(x.abs()));
        let what = format!("d(eps, t') of {name}");
        f.derivative(&what, &closed, Some(&dual[rows.clone()]), Some(&by_tape[i]), Some(&central[rows]), scale);
        let blocked = if i == 0 { [3, 4] } else { [5, 5] };
        f.residual("closed form: blocks that are zero", blocked.iter().map(|&k| closed[k].abs()).sum(), 0.0);
    }
}

const PLANAR: [PlanarForm; 4] = [PlanarForm::Literal, PlanarForm::Robust, PlanarForm::Circular, PlanarForm::Weighted];
const AXIAL: [AxialForm; 5] =
    [AxialForm::Literal, AxialForm::Signed, AxialForm::Folded, AxialForm::PoseSign, AxialForm::PerpendicularPixels];

/// No path leads on the tape from either loss to the other part of `t'`: exact zeros, in both conventions.
fn blocks(e: &Estimate, f: &mut Findings) {
    for convention in [Convention::AsPrinted, Convention::Consistent] {
        for form in PLANAR {
            let (_, a) = taped_gradient(e, convention, |pair| planar_form(pair, form));
            f.residual("tape: dL_pla/dt'_x, dL_pla/dt'_y", a[0].abs() + a[1].abs(), 0.0);
            f.residual("tape: forms of L_pla without any gradient along t'_z", f64::from(u8::from(a[2] == 0.0)), 0.0);
        }
        for form in AXIAL {
            let (_, a) = taped_gradient(e, convention, |pair| axial_form(pair, form));
            f.residual("tape: dL_axi/dt'_z", a[2].abs(), 0.0);
            f.residual(
                "tape: forms of L_axi without any gradient along t'_x, t'_y",
                f64::from(u8::from(a[0] == 0.0 || a[1] == 0.0)),
                0.0,
            );
        }
    }
}

/// Gradient of the circular loss with `t` as the parameter, and the one along `t'_z`.
fn with_source_translation(e: &Estimate) -> (Vector3<f64>, f64) {
    let (gradient, removed) = taped_gradient(e, Convention::Consistent, |pair| planar_form(pair, PlanarForm::Circular));
    (Vector3::new(gradient[3], gradient[4], gradient[5]), removed[2])
}

fn misfit(e: &Estimate) -> f64 {
    let (gradient, radial) = with_source_translation(e);
    (gradient - e.rotation.column(2) * radial).norm() / radial.abs()
}

/// What `t_x` and `t_y` get, as a share of the radial gradient.
fn shared(e: &Estimate) -> f64 {
    let (gradient, radial) = with_source_translation(e);
    gradient.xy().norm() / radial.abs()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::ledger::testing::holds;

    proptest! {
        #[test]
        fn holds_for_every_estimate(x in prop::array::uniform8(0.0f64..1.0), which in 0usize..3) {
            let reference = [scenes::handheld(), scenes::generic(), scenes::turn()][which].clone();
            holds(|f| at(&Estimate::new(&reference, &x), f))?;
        }
    }
}
