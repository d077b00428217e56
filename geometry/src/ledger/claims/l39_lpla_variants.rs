//! L39: forms of the planar loss that measure parallelism.

use dimode_autodiff::proof::Dual;
use nalgebra::{Rotation2, Vector2};

use crate::ledger::forward::{V2, direction, fixed};
use crate::ledger::{Case, Claim, Findings, Trial, Verdict, loss_slopes as by, taped};
use crate::loss_forms::planar::{self, gradients};
use crate::losses::{self, LossOptions, PlanarForm};
use crate::scenes;

pub(super) static CLAIM: Claim = Claim {
    id: "L39",
    slug: "lpla-variants",
    place: "derived from eq. lp",
    statement: "2 (1 - |E[f / |f|]|) and 2 (1 - |sum f| / sum |f|) measure parallelism: zero exactly for parallel flows of one \
                orientation, the same in every direction, with the gradients below.",
    verdict: Verdict::Exact,
    condition: Some("flows and their mean direction not zero"),
    formula: "circular: dL/df_i = (2/N) sin(theta_i - theta_mean) (-sin theta_i, cos theta_i) / |f_i|; weighted: dL/df_i = \
              -(2/S) (m - (|sum f|/S) f_i/|f_i|), S = sum |f|, m = sum f / |sum f|",
    derivation: "|E[n]| <= E|n| = 1 with equality exactly for equal unit vectors n. d|E[n]| = m . dn_i / N with the unit \
                 vector m of the mean, and dn_i = (-sin, cos) dtheta_i. The variance of atan2 alone is not enough: it jumps \
                 for leftward flows.",
    counter_example: None,
    correction: None,
    functions: &[
        "loss_forms::planar::circular",
        "loss_forms::planar::weighted",
        "loss_forms::planar::unfolded",
        "loss_forms::planar::gradients::circular",
        "loss_forms::planar::gradients::weighted",
        "loss_forms::planar::gradients::printed",
        "loss_forms::planar::gradients::unfolded",
        "loss_forms::planar::gradients::perpendicular",
    ],
    taped: &["losses::planar"],
    missing_way: None,
    check,
};

fn list<const N: usize>(flows: [[f64; 2]; N]) -> Vec<Vector2<f64>> {
    flows.into_iter().map(Vector2::from).collect()
}

fn check(trial: &mut Trial) {
    trial.cases(values);
    // Six tapes a case: a quarter of the cases is enough.
    let samples = trial.samples;
    trial.samples = samples.div_ceil(4);
    trial.cases(slopes);
    trial.samples = samples;
    let f = &mut trial.findings;
    let four = list([[1.0, 0.3], [0.8, -0.2], [1.5, 0.1], [0.9, 0.4]]);
    f.documented("four flows, documented", planar::circular(&four), 0.0628604790196, 1e-11);
    f.documented("four flows, documented", planar::weighted(&four), 0.0524351566505, 1e-11);
    f.documented("four flows, documented", planar::printed(&four), 0.01589447169, 1e-11);
    let (circular, weighted) = (gradients::circular(&four)[0], gradients::weighted(&four)[0]);
    let documented = [(circular, [-0.0215835922527, 0.0719453075089]), (weighted, [-0.0262735087143, 0.0635286583085])];
    for (found, expected) in documented {
        f.documented("gradient of the first of four flows, documented", found.x, expected[0], 1e-11);
        f.documented("gradient of the first of four flows, documented", found.y, expected[1], 1e-11);
    }
    let flipped = list([[1.0, 0.0], [1.0, 0.0], [2.0, 0.0], [-1.0, 0.0]]);
    f.documented("one flow in four reversed, documented", planar::printed(&flipped), 1.8505508252, 1e-10);
    f.documented("one flow in four reversed, documented", planar::circular(&flipped), 1.0, 1e-12);
    f.documented("one flow in four reversed, documented", planar::weighted(&flipped), 0.8, 1e-12);
    let mirrored = list([[1.0, 0.5], [1.0, -0.5]]);
    let upright = list([[-0.5, 1.0], [0.5, 1.0]]);
    f.gap("printed loss after a quarter turn, rad^2", planar::printed(&upright) - planar::printed(&mirrored), 0.19);
    let leftward = list([[-1.0, 0.01], [-1.0, -0.01], [-2.0, 0.02], [-2.0, -0.02]]);
    f.documented("variance of atan2 of leftward flows, documented", planar::unfolded(&leftward), 9.80687463562, 1e-11);
    f.gap("variance of atan2 of flows parallel to 0.01 rad, rad^2", planar::unfolded(&leftward), 9.0);
    f.bound("circular loss of flows parallel to 0.01 rad", planar::circular(&leftward), 1e-4);
}

fn flows(case: &Case) -> Vec<Vector2<f64>> {
    (0..5).map(|i| case.extra_flow(2 * i)).collect()
}

fn values(case: &Case, f: &mut Findings) {
    let flows = flows(case);
    invariances(case, &flows, f);
    small_spread(case, &flows, f);
}

fn slopes(case: &Case, f: &mut Findings) {
    let flows = flows(case);
    let unit: Vector2<f64> = flows.iter().map(|x| x / x.norm()).sum();
    let sum: Vector2<f64> = flows.iter().sum();
    let lengths: f64 = flows.iter().map(|x| x.norm()).sum();
    // Where the directions cancel, or the flows do, the length of their mean has a tip.
    if unit.norm() < 0.05 * flows.len() as f64 || sum.norm() < 0.05 * lengths {
        return;
    }
    derivatives(&flows, f);
}

fn invariances(case: &Case, flows: &[Vector2<f64>], f: &mut Findings) {
    let turn = Rotation2::new(case.extra(10, 0.0, std::f64::consts::TAU));
    let turned: Vec<_> = flows.iter().map(|x| turn * x).collect();
    let stretched: Vec<_> = flows.iter().enumerate().map(|(i, x)| x * (1.0 + i as f64)).collect();
    f.residual("circular loss after a common rotation", planar::circular(flows) - planar::circular(&turned), 1e-12);
    f.residual("weighted loss after a common rotation", planar::weighted(flows) - planar::weighted(&turned), 1e-12);
    f.residual("circular loss after scaling every flow", planar::circular(flows) - planar::circular(&stretched), 1e-12);
}

/// To second order in the spread the circular loss is the variance of the angles, in every direction.
fn small_spread(case: &Case, flows: &[Vector2<f64>], f: &mut Findings) {
    let centre = case.extra(10, 0.0, std::f64::consts::TAU);
    const SPREAD: f64 = 1e-3;
    let angles = flows.iter().map(|x| centre + SPREAD * x.y / x.norm());
    let close: Vec<_> = angles.map(|a| Vector2::new(a.cos(), a.sin())).collect();
    let variance = planar::wrapped(&close);
    // The angles may happen to be almost equal, so that the size is that of the spread; the rest is of its fourth order.
    let miss = (planar::circular(&close) - variance).abs() / SPREAD.powi(2);
    f.bound("angles within s = 1e-3 rad: |circular loss - variance of the angles| / s^2", miss, SPREAD.powi(2));
}

/// A form of the loss: name, closed gradient, forward mode, plain value, tape.
type Form = (
    &'static str,
    fn(&[Vector2<f64>]) -> Vec<Vector2<f64>>,
    fn(&[V2<Dual>]) -> Dual,
    fn(&[V2<f64>]) -> f64,
    fn(&[Vector2<f64>]) -> Vec<f64>,
);

/// A translation whose image `f o a_tan` is the line of the pixel form.
const A: [f64; 3] = [0.3, -0.2, 0.0];

fn line() -> [f64; 2] {
    let camera = scenes::kitti640();
    [camera.fu * A[0], camera.fv * A[1]]
}

const FORMS: [Form; 6] = [
    ("circular", gradients::circular, direction::planar_circular, direction::planar_circular, |x| {
        taped_gradient(x, PlanarForm::Circular)
    }),
    ("weighted", gradients::weighted, direction::planar_weighted, direction::planar_weighted, |x| {
        taped_gradient(x, PlanarForm::Weighted)
    }),
    ("printed, arc cosine on the tape", gradients::printed, direction::planar_printed, direction::planar_printed, |x| {
        taped_gradient(x, PlanarForm::Literal)
    }),
    ("printed, atan2 on the tape", gradients::printed, direction::planar_printed, direction::planar_printed, |x| {
        taped_gradient(x, PlanarForm::Robust)
    }),
    ("variance of atan2", gradients::unfolded, direction::planar_unfolded, direction::planar_unfolded, taped_unfolded),
    (
        "distance from a line",
        |flows| gradients::perpendicular(flows, &line().into()),
        |flows| direction::planar_perpendicular(flows, fixed(line())),
        |flows| direction::planar_perpendicular(flows, line()),
        |x| taped_gradient(x, PlanarForm::PerpendicularPixels),
    ),
];

fn derivatives(flows: &[Vector2<f64>], f: &mut Findings) {
    let line: Vector2<f64> = line().into();
    let off = |f: &Vector2<f64>, axis: &Vector2<f64>| f.perp(axis).abs() > 1e-2 * f.norm() * axis.norm();
    // Kinks of the forms with a magnitude in them: flows along the horizontal axis and along the line.
    if !flows.iter().all(|f| off(f, &Vector2::x()) && off(f, &line)) {
        return;
    }
    for (name, closed, dual, plain, tape) in FORMS {
        let closed = by::scaled(flows, &closed(flows));
        // One long flow among short ones leaves hardly any slope, while differences of a loss of the size 1 stay at 1e-10.
        let scale = closed.iter().fold(0.01f64, |m, x| m.max(x.abs()));
        let (forward, tape, central) = (by::forward(flows, dual), tape(flows), by::central(flows, plain));
        f.derivative(&format!("dL/df, {name}, lengths of the flow"), &closed, Some(&forward), Some(&tape), Some(&central), scale);
    }
}

fn taped_gradient(flows: &[Vector2<f64>], form: PlanarForm) -> Vec<f64> {
    let options = LossOptions { planar: form, ..taped::bare() };
    let cameras = [scenes::kitti640()];
    by::taped_image(flows, |x| losses::planar(&taped::still_pair(x, A, &cameras, &options), &options).mean)
}

fn taped_unfolded(flows: &[Vector2<f64>]) -> Vec<f64> {
    by::taped_image(flows, |x| {
        let angle = x.slice(1, 1, 1).atan2(x.slice(1, 0, 1));
        angle.sub(angle.mean().broadcast_to(angle.shape())).square().mean()
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::ledger::testing::{case, holds, limit};

    proptest! {
        #[test]
        fn holds_everywhere(case in case()) {
            holds(|f| {
                values(&case, f);
                slopes(&case, f);
            })?;
        }

        #[test]
        fn holds_at_the_limits(case in limit()) {
            holds(|f| {
                values(&case, f);
                slopes(&case, f);
            })?;
        }

        #[test]
        fn the_weighted_gradient_is_bounded_however_short_a_flow(case in case(), tiny in 1e-12f64..1e-3) {
            let mut flows: Vec<_> = (0..4).map(|i| case.extra_flow(2 * i)).collect();
            flows.push(case.extra_flow(8) * tiny);
            let total: f64 = flows.iter().map(|f| f.norm()).sum();
            prop_assert!(gradients::weighted(&flows).iter().all(|g| g.norm() <= 4.0 / total * (1.0 + 1e-12)));
        }
    }
}
