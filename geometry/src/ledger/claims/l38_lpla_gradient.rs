//! L38: the gradient of the printed angle.

use dimode_autodiff::Var;
use nalgebra::Vector2;

use crate::ledger::forward::{V2, direction};
use crate::ledger::{Case, Claim, Findings, Trial, Verdict, loss_slopes as by, taped};
use crate::loss_forms::planar::gradients;
use crate::losses::{self, LossOptions, PlanarForm};

pub(super) static CLAIM: Claim = Claim {
    id: "L38",
    slug: "lpla-gradient",
    place: "eq. lp",
    statement: "The angle arccos(e_1 . f / |f|) of eq. lp can be differentiated with respect to the flow.",
    verdict: Verdict::Conditional,
    condition: Some("f_v and f not zero, and not by the chain rule through arccos"),
    formula: "d theta / df = sign(f_v) (-f_v, f_u) / |f|^2",
    derivation: "d arccos(c) / dc = -1 / sqrt(1 - c^2) = -|f| / |f_v| grows without bound as f_v -> 0, while dc/df = f_v^2, \
                 -f_u f_v over |f|^3 vanishes: the product stays 1 / |f| long and changes its sign at f_v = 0. Taken factor by \
                 factor it is infinity times 0.",
    counter_example: Some(
        "One horizontal flow among others makes the gradient NaN where the arc cosine is differentiated as written; the \
         printed form of losses::planar takes the slope 0 there. In f32 the cosine rounds to 1 for |f_v / f_u| < 2.4e-4, and a \
         clamp at 1 - 1e-7 hides angles below 4.5e-4 rad. Near f = 0 every form has a gradient of the size 1 / |f|.",
    ),
    correction: Some("Evaluate the angle as atan2(|f_v|, f_u) and leave out flows shorter than a threshold."),
    functions: &[
        "loss_forms::planar::gradients::folded_angle",
        "loss_forms::planar::gradients::arccos_slope",
        "loss_forms::planar::gradients::printed",
    ],
    taped: &["losses::planar"],
    missing_way: None,
    check,
};

/// Row `f_v` of the table for `f_u = 1`: slope of the arc cosine and the two derivatives of the angle.
const TABLE: [[f64; 4]; 2] =
    [[1e-2, -100.004999875, -0.00999900009999, 0.999900009999], [1e-4, -10000.00005, -9.9999999e-05, 0.99999999]];

fn check(trial: &mut Trial) {
    trial.cases(at);
    let f = &mut trial.findings;
    for [v, slope, along_u, along_v] in TABLE {
        let flow = Vector2::new(1.0, v);
        let gradient = gradients::folded_angle(&flow);
        f.documented("slope of the arc cosine, documented", gradients::arccos_slope(&flow), slope, 1e-10);
        f.documented("gradient of the angle, documented", gradient.x, along_u, 1e-8);
        f.documented("gradient of the angle, documented", gradient.y, along_v, 1e-10);
    }
    horizontal(f);
    rounding(f);
}

/// One flow exactly horizontal: the chain rule fails, the angle by `atan2` does not.
fn horizontal(f: &mut Findings) {
    let flows = [Vector2::new(1.0, 0.0), Vector2::new(2.0, 0.7), Vector2::new(0.4, -0.3)];
    let unusable = |gradient: Vec<f64>| gradient.iter().filter(|x| !x.is_finite()).count() as f64;
    f.gap("entries of the arccos gradient that are no numbers", unusable(by::taped_image(&flows, variance_as_written)), 1.0);
    for (form, name) in [(PlanarForm::Literal, "printed"), (PlanarForm::Robust, "atan2")] {
        let what = format!("entries of the {name} gradient of losses::planar that are no numbers");
        f.residual(&what, unusable(taped_gradient(&flows, form)), 0.0);
    }
    let closed = gradients::printed(&flows).iter().filter(|g| !(g.x.is_finite() && g.y.is_finite())).count();
    f.residual("entries of the closed gradient that are no numbers", closed as f64, 0.0);
}

/// Small angles that an arc cosine loses.
fn rounding(f: &mut Findings) {
    let cosine = |v: f64| 1.0 / (1.0 + v * v).sqrt();
    let lost = |v: f64| v - f64::from((cosine(v) as f32).acos());
    f.gap("angle that the arc cosine in f32 takes for 0, rad", lost(2.4e-4), 2.39e-4);
    f.gap("angle that the arc cosine in f64 takes for 0, rad", 1.0e-8 - cosine(1.0e-8).acos(), 0.99e-8);
    f.gap("angle at which a cosine clamped at 1 - 1e-7 begins, rad", (1.0f64 - 1e-7).acos(), 4.4e-4);
}

/// `Var(arccos(f_u / |f|))` with the slope of the arc cosine as it is.
fn variance_as_written<'t>(flows: Var<'t, f64>) -> Var<'t, f64> {
    let [u, v] = [0, 1].map(|c| flows.slice(1, c, 1));
    let angle = u.div(u.square().add(v.square()).sqrt()).acos();
    angle.sub(angle.mean().broadcast_to(angle.shape())).square().mean()
}

fn taped_gradient(flows: &[Vector2<f64>], form: PlanarForm) -> Vec<f64> {
    let options = LossOptions { planar: form, ..taped::bare() };
    let camera = taped::pixel_camera(&crate::scenes::kitti640(), &Vector2::zeros());
    by::taped_image(flows, |x| losses::planar(&taped::still_pair(x, [0.0; 3], &[camera], &options), &options).mean)
}

fn at(case: &Case, f: &mut Findings) {
    let flow = case.extra_flow(0);
    // Closer to the axis the arc cosine itself, which forward mode goes through, has lost too many digits.
    if flow.y.abs() < 1e-2 * flow.norm() {
        return;
    }
    let closed = by::scaled(&[flow], &[gradients::folded_angle(&flow)]);
    let forward = by::forward(&[flow], |f| direction::angle_by_arccos(f[0]));
    let central = by::central(&[flow], |f: &[V2<f64>]| f[0][1].abs().atan2(f[0][0]));
    let tape = by::taped_image(&[flow], |x| x.slice(1, 1, 1).abs().atan2(x.slice(1, 0, 1)).sum());
    f.derivative("d theta / d f, lengths of the flow", &closed, Some(&forward), Some(&tape), Some(&central), 1.0);
    f.residual("|f| |d theta / df| - 1", closed[0].hypot(closed[1]) - 1.0, 1e-13);
    let chain = gradients::arccos_slope(&flow) * Vector2::new(flow.y * flow.y, -flow.x * flow.y) / flow.norm().powi(2);
    f.residual(
        "slope of the arc cosine times dc/df - closed form, lengths of the flow",
        (chain - Vector2::new(closed[0], closed[1])).norm(),
        1e-12,
    );
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
        fn close_to_the_axis_the_atan2_form_still_agrees_with_differences(u in 0.01f64..100.0, tilt in 1e-3f64..1e-2) {
            let flow = Vector2::new(u, -u * tilt);
            let closed = by::scaled(&[flow], &[gradients::folded_angle(&flow)]);
            let central = by::central(&[flow], |f: &[V2<f64>]| f[0][1].abs().atan2(f[0][0]));
            prop_assert!(closed.iter().zip(&central).all(|(a, b)| (a - b).abs() < 1e-6));
        }
    }
}
