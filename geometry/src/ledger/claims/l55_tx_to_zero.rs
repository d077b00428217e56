//! L55: the tangential ratio loss as a translation component goes to zero, and bounded forms in its place.

use dimode_autodiff::proof::Number;
use dimode_autodiff::{Tensor, Var};
use nalgebra::{Vector2, Vector3};

use crate::alignment::Convention;
use crate::flow::tangential::{focal_scaled, tangential_flow};
use crate::ledger::{Case, Claim, Findings, Trial, Verdict, estimates, forward, taped};
use crate::loss_forms::{ratio_terms, tangential};
use crate::losses::{self, AlignedPair, LossOptions, PairInputs, TangentialForm};
use crate::ratios::{inverse_depth_along_flow, inverse_depth_along_flow_slope};
use crate::scenes::{self, Perturbed, Reference};
use crate::taped::masks;

pub(super) static CLAIM: Claim = Claim {
    id: "L55",
    slug: "tx-to-zero",
    place: "eq. lt",
    statement: "L_tan constrains depth and tangential translation at every motion.",
    verdict: Verdict::Fails,
    condition: None,
    formula: "second term = |m| / |t_x|,  m = E[z n / f_u],  n the error of the flow",
    derivation: "E[z / rho_x] = E[z (f_u t_x / z + n) / f_u] = t_x + m. The error m of the flow does not shrink with t_x, so \
                 that m / t_x has no bound; at t_x = 0 the first term is 0 times infinity and the second divides by 0.",
    counter_example: Some(
        "Road scene, flow error 0.3 sin(12.9898 u + 78.233 v) px: at t_x = 0.5, 0.02, 0.001 m the pixel term is 0.0189, 2.39, \
         1.15 and the aggregate term 0.000115, 0.00287, 0.0573; at t_x = 0 neither is a number.",
    ),
    correction: Some(
        "One ratio for both axes, along the predicted flow: 1/z_geo = (F . f_pla) / |F|^2, F = f o t'_tan, linear in the flow; \
         or the residual |F / z - f_pla| in pixels, whose slopes stay below f_u / z, f_v / z.",
    ),
    functions: &[
        "loss_forms::ratio_terms::aggregate_term_of_noise",
        "ratios::inverse_depth_along_flow",
        "ratios::inverse_depth_along_flow_slope",
        "loss_forms::tangential::flow_pixels",
        "loss_forms::tangential::flow_pixels_slopes",
    ],
    taped: &["losses::tangential"],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    let table = [
        (0.5, 0.0188966, 0.000114676),
        (0.1, 0.0991146, 0.000573378),
        (0.02, 2.38716, 0.00286689),
        (0.005, 2.42807, 0.0114676),
        (0.001, 1.15436, 0.0573378),
    ];
    let f = &mut trial.findings;
    for (t_x, pixel, aggregate) in table {
        let [found, sum] = printed_terms(t_x, f);
        f.documented("pixel term on the road, documented to six digits", found, pixel, 5e-6);
        f.documented("aggregate term on the road, documented to six digits", sum, aggregate, 5e-6);
        f.gap("pixel term of a flow error of 0.3 px", found, 2.2);
        f.gap("aggregate term over that at t_x = 0.5 m", sum / table[0].2, 450.0);
    }
    for t_x in [0.0, 1e-8, 1e-3, 0.5] {
        vanishing(t_x, f);
    }
    trial.count(9 * scenes::road().pixels.len());
}

fn noise(p: &Vector2<f64>) -> f64 {
    0.3 * (12.9898 * p.x + 78.233 * p.y).sin()
}

/// Pixel and aggregate term along u on the road, with its flow error.
fn printed_terms(t_x: f64, f: &mut Findings) -> [f64; 2] {
    let scene = scenes::road();
    let t = Vector3::new(t_x, 0.0, 0.0);
    let flow = |(p, &z): (&Vector2<f64>, &f64)| tangential_flow(&scene.camera, &t, z) + Vector2::new(noise(p), 0.0);
    let flows: Vec<_> = scene.pixels.iter().zip(&scene.depths).map(flow).collect();
    let [pixel, aggregate, ..] = tangential::printed_terms(&scene.camera, &flows, &scene.depths, &t);
    let errors: Vec<f64> = scene.pixels.iter().map(noise).collect();
    let closed = ratio_terms::aggregate_term_of_noise(&errors, &scene.depths, scene.camera.fu, t_x);
    f.equal("aggregate term - |m| / |t_x|, relative", aggregate, closed, closed, 1e-9);
    [pixel, aggregate]
}

/// All forms at one small translation along u, values and derivatives, with flow errors on both axes.
fn vanishing(t_x: f64, f: &mut Findings) {
    let reference = Reference { name: "slow", scene: scenes::road(), motion: scenes::motion([0.0; 3], [t_x, 0.02, -0.8]) };
    let mut estimate = Perturbed::exact(&reference);
    estimate.matches.iter_mut().for_each(|m| m.source += Vector2::new(noise(&m.target), 0.5 * noise(&m.target)));
    let bad = |form: TangentialForm| {
        let options = LossOptions { convention: Convention::Consistent, tangential: form, ..LossOptions::literal() };
        let loss = estimates::taped_loss(&estimate, &estimates::on_the_grid(&options), losses::tangential);
        let rest = [loss.value].into_iter().chain(loss.changes(0)).chain(loss.log_target).chain(loss.log_source);
        rest.filter(|x| !x.is_finite()).count() as f64
    };
    for form in [TangentialForm::FlowPixels, TangentialForm::InverseRatio, TangentialForm::Robust] {
        f.residual("bounded forms: values and derivatives that are not finite", bad(form), 0.0);
    }
    let flows = estimate.planar_flows();
    let printed = tangential::printed(&estimate.scene.camera, &flows, &estimate.target_depths, &estimate.in_target);
    if t_x == 0.0 {
        // Training leaves out what is divided by a component of exactly 0; beside 0 the printed form overflows.
        f.residual(
            "printed form on the tape at t_x = 0: values and derivatives that are not finite",
            bad(TangentialForm::Literal),
            0.0,
        );
        f.residual("finite values of the plain printed form at t_x = 0", f64::from(u8::from(printed.is_finite())), 0.0);
    }
}

/// The bounded forms at one pixel; the case's last numbers choose which component of the translation vanishes.
fn at(case: &Case, f: &mut Findings) {
    let mut t = case.motion.translation;
    match (4.0 * case.extra[0]) as usize {
        0 => t.x = 0.0,
        1 => t.x *= 1e-8,
        2 => t.y = 0.0,
        _ => {}
    }
    let (camera, z) = (&case.camera, case.depth);
    let predicted = focal_scaled(camera, &t);
    if predicted.norm() == 0.0 {
        return;
    }
    let flow = tangential_flow(camera, &t, z);
    f.residual("z (F . f_pla) / |F|^2 - 1 of exact flow", z * inverse_depth_along_flow(camera, &flow, &t) - 1.0, 1e-12);
    // Errors of 0.3 px and more: the residual's kink is at 0.
    let angle = case.extra(1, 0.0, std::f64::consts::TAU);
    let error = Vector2::new(angle.cos(), angle.sin()) * case.extra(2, 0.3, 2.0);
    let moved = inverse_depth_along_flow(camera, &(flow + error), &t) - inverse_depth_along_flow(camera, &flow, &t);
    let reach = error.norm() / predicted.norm();
    let size = reach + 1.0 / z;
    let linear = predicted.dot(&error) / predicted.norm_squared();
    f.equal("1/z_geo is linear in the flow: change - F . n / |F|^2", moved, linear, size, 1e-12);
    f.bound("change of 1/z_geo over |n| / |F|, without rounding", (moved.abs() - 1e-9 * size) / reach, 1.0 + 1e-12);
    slope_along_flow(case, &t, flow + error, f);
    slopes_in_pixels(case, &t, flow + error, f);
}

/// Derivative of `1/z_geo` with respect to the flow.
fn slope_along_flow(case: &Case, t: &Vector3<f64>, flow: Vector2<f64>, f: &mut Findings) {
    let [f_u, f_v] = [case.camera.fu * t.x, case.camera.fv * t.y];
    let closed = inverse_depth_along_flow_slope(&case.camera, t);
    fn along<N: Number>([u, v]: [N; 2], [f_u, f_v]: [f64; 2]) -> N {
        (u * N::constant(f_u) + v * N::constant(f_v)) / N::constant(f_u * f_u + f_v * f_v)
    }
    let dual = forward::jacobian(flow.into(), |x| [along(x, [f_u, f_v])]);
    // Linear, so that a long step costs nothing but saves digits.
    let step = 0.1 * (1.0 + flow.norm());
    let central = forward::central(flow.into(), [step; 2], |x| [along(x, [f_u, f_v])]);
    let (_, rows) = taped::jacobian(&[taped::column(flow.as_slice())], |v| {
        let size = v[0].tape().constant(taped::column(&[f_u, f_v]));
        v[0].mul(size).sum_chw().scale(1.0 / (f_u * f_u + f_v * f_v))
    });
    f.derivative("d(1/z_geo)/df", closed.as_slice(), Some(&dual), Some(&rows[0]), Some(&central), closed.norm());
}

/// Derivatives of the flow-space residual with respect to `t_x`, `t_y`, `z`.
fn slopes_in_pixels(case: &Case, t: &Vector3<f64>, flow: Vector2<f64>, f: &mut Findings) {
    let (camera, z) = (&case.camera, case.depth);
    let closed = tangential::flow_pixels_slopes(camera, &flow, z, t);
    let residual = |[t_x, t_y, z]: [f64; 3]| length(camera, flow, [t_x, t_y, z]);
    let dual = forward::jacobian([t.x, t.y, z], |x| [length(camera, flow, x)]);
    // Steps of 1e-4 px in the image.
    let reach = tangential_flow(camera, t, z).norm() + 1.0;
    let steps = [1e-4 * z / camera.fu, 1e-4 * z / camera.fv, 1e-4 * z / reach];
    let central = forward::central([t.x, t.y, z], steps, |x| [residual(x)]);
    let inputs = [taped::column(&[t.x, t.y, 0.0]), taped::column(&[z])];
    let (_, rows) = taped::jacobian(&inputs, |v| one_pixel(camera, flow, v));
    let tape = [rows[0][0], rows[0][1], rows[0][3]];
    let scale = camera.fu.max(camera.fv) / z;
    f.derivative("d|F/z - f_pla| / d(t_x, t_y, z)", closed.as_slice(), Some(&dual), Some(&tape), Some(&central), scale);
    let largest = (closed.x.abs() / camera.fu).max(closed.y.abs() / camera.fv) * z;
    f.bound("slopes over f_u / z, f_v / z", largest, 1.0 + 1e-12);
}

fn length<N: Number>(camera: &crate::Intrinsics, flow: Vector2<f64>, [t_x, t_y, z]: [N; 3]) -> N {
    let u = N::constant(camera.fu) * t_x / z - N::constant(flow.x);
    let v = N::constant(camera.fv) * t_y / z - N::constant(flow.y);
    (u * u + v * v).sqrt()
}

/// `L_tan` in pixels over an image of one pixel, without rotation and radial translation: the flow is the planar flow.
fn one_pixel<'t>(camera: &crate::Intrinsics, flow: Vector2<f64>, v: &[Var<'t, f64>]) -> Var<'t, f64> {
    let tape = v[0].tape();
    let intrinsics = [taped::pixel_camera(camera, &Vector2::zeros())];
    let identity = crate::taped::so3_exp(tape.constant(taped::column(&[0.0; 3])));
    let options = LossOptions { noise_pixels: 0.0, noise_share: 0.0, min_valid_share: 0.0, ..LossOptions::default() };
    let map = v[1].shape();
    let inputs = PairInputs {
        target_depth: v[1],
        source_depth: tape.constant(Tensor::full(map, 1.0)),
        flow: tape.constant(taped::column(flow.as_slice())),
        rotation: identity,
        translation: v[0],
        intrinsics: &intrinsics,
        mask: &masks::everywhere(map),
    };
    losses::tangential(&AlignedPair::from_sampled(&inputs, &options), &options).mean
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::ledger::testing::{case, holds, limit};

    proptest! {
        #[test]
        fn holds_everywhere(case in case()) {
            holds(|f| at(&case, f))?;
        }

        #[test]
        fn holds_at_the_limits(case in limit()) {
            holds(|f| at(&case, f))?;
        }

        #[test]
        fn bounded_forms_stay_finite(exponent in -300.0f64..0.0, sign in any::<bool>(), zero in any::<bool>()) {
            let t_x = if zero { 0.0 } else { 10f64.powf(exponent) * if sign { 1.0 } else { -1.0 } };
            holds(|f| vanishing(t_x, f))?;
        }
    }
}
