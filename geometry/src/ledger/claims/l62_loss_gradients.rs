//! L62: end-to-end derivatives of the losses.

use std::ops::Range;

use crate::alignment::Convention;
use crate::ledger::estimates::{self, Clearance, Form, PlainLosses, TapedLoss};
use crate::ledger::forward::{self, pipeline};
use crate::ledger::{Claim, Findings, Trial, Verdict};
use crate::losses::{self, AxialForm, LossOptions, PlanarForm};
use crate::scenes::{self, Perturbed};

pub(super) static CLAIM: Claim = Claim {
    id: "L62",
    slug: "loss-gradients",
    place: "derived, for eqs. lp, la, lt, lr",
    statement: "The four losses, from estimated depths and motion through the alignment to the mean, have the derivatives that \
                training follows.",
    verdict: Verdict::Exact,
    condition: Some("away from kinks (a flow along its radius, rho t = z) and poles (a flow component of zero)"),
    formula: "dL / d(eps, t', log z_t, log z_s),  R = R_hat exp([eps]_x)",
    derivation: "Chain rule from the loss through directions or ratios, projection and alignment to the estimates. Two \
                 implementations that share no code, one differentiated forwards and one backwards, agree on all of them, and \
                 with differences of a computation of 40 digits. In float64 a difference cannot be relied on everywhere: the \
                 absolute values have kinks, of which a step of 1e-6 already crosses one in the second documented scene, and a \
                 step of 1e-8 leaves 7 digits of the slowest losses.",
    counter_example: None,
    correction: None,
    functions: &["ledger::forward::pipeline::losses", "ledger::estimates::taped_loss", "ledger::estimates::PlainLosses::new"],
    taped: &["losses::planar", "losses::axial", "losses::tangential", "losses::radial"],
    missing_way: Some(
        "Forward mode takes the place of the closed form, which would be the whole chain rule written out; one pixel's share \
         of a mean is too small for central differences.",
    ),
    check,
};

const PIXEL: usize = 100;
const NAMES: [&str; 5] = ["L_pla circular", "L_pla weighted", "L_axi sign-aware", "L_tan", "L_rad"];
/// What the columns of a row differentiate by.
const GROUPS: [(&str, Range<usize>); 6] =
    [("eps", 0..3), ("t'", 3..6), ("log z_t", 6..7), ("one log z_t", 7..8), ("log z_s", 8..9), ("one log z_s", 9..10)];

fn check(trial: &mut Trial) {
    let references = scenes::references();
    for i in 0..(trial.samples / 200).max(3) {
        let x: [f64; 8] = std::array::from_fn(|_| trial.draw.uniform(-1.0, 1.0));
        let estimate = Perturbed::drawn(&references[i % references.len()], &x);
        at(&estimate, &mut trial.findings);
        trial.count(estimate.matches.len());
    }
    at(&scenes::perturbed_generic(), &mut trial.findings);
    at(&scenes::perturbed_handheld(), &mut trial.findings);
    trial.count(2 * scenes::room().pixels.len());
    differences(&scenes::perturbed_generic(), &mut trial.findings);
    documented(&mut trial.findings);
}

fn documented(f: &mut Findings) {
    let estimate = scenes::perturbed_generic();
    let value = PlainLosses::new(&estimate).axial[0];
    f.documented("L_axi of perturbed generic, documented", value, 0.0525357388878, 1e-11);
    let rows = derivatives(&estimate);
    let expected = [9.60628487081, 9.16484642302, -0.917498114116, 3.80983878558, -4.0345669218, 0.0];
    for (found, expected) in rows[2].iter().zip(expected) {
        f.documented("its derivatives by eps and t', documented", *found, expected, 1e-11);
    }
    let expected = [5357.609185242, 4338.789354933, -213.4324854153, 1852.0668528, -2282.448616072, -23.68901051667];
    for (found, expected) in derivatives(&scenes::perturbed_handheld())[4].iter().zip(expected) {
        f.documented("L_rad of perturbed handheld: derivatives by eps and t', documented", *found, expected, 1e-8);
    }
}

/// Forward mode: one row a loss.
fn derivatives(estimate: &Perturbed) -> [[f64; pipeline::CHANGES]; 5] {
    let rows = forward::jacobian([0.0; pipeline::CHANGES], |x| pipeline::losses(estimate, PIXEL, x));
    std::array::from_fn(|k| std::array::from_fn(|i| rows[k * pipeline::CHANGES + i]))
}

fn forms() -> [(LossOptions, Form); 5] {
    let literal = LossOptions { convention: Convention::Consistent, tau_flow: 0.0, q_min: 0.0, ..LossOptions::literal() };
    [
        (LossOptions { planar: PlanarForm::Circular, ..literal }, losses::planar),
        (LossOptions { planar: PlanarForm::Weighted, ..literal }, losses::planar),
        (LossOptions { axial: AxialForm::PoseSign, ..literal }, losses::axial),
        (literal, losses::tangential),
        (literal, losses::radial),
    ]
}

/// Values by all three implementations, derivatives by forward mode and the tape.
fn at(estimate: &Perturbed, f: &mut Findings) {
    let plain = PlainLosses::new(estimate).differentiated();
    let values = pipeline::losses(estimate, PIXEL, [0.0; pipeline::CHANGES]);
    let rows = derivatives(estimate);
    let clear = Clearance::new(estimate);
    for (k, (options, form)) in forms().into_iter().enumerate() {
        // Too close to a pole or kink, rounding of 1e-13 px in a flow may lie on its other side.
        if (k > 2 && clear.divisor < 1e-3) || (k == 2 && clear.radial < 1e-8) {
            continue;
        }
        let loss = estimates::taped_loss(estimate, &options, form);
        let rounding = if k > 2 { clear.rounding() } else { 1.0 };
        let size = (1.0 + plain[k]) * rounding;
        f.equal("values: forward implementation - plain, relative to 1 + L", values[k], plain[k], size, 1e-10);
        f.equal("values: tape - plain, relative to 1 + L", loss.value, plain[k], size, 1e-10);
        let changes = loss.changes(PIXEL);
        for (group, columns) in groups(k) {
            let scale = scale_of(&rows[k], &loss, &columns) * rounding;
            let (forward, tape) = (&rows[k][columns.clone()], &changes[columns]);
            f.derivative(&format!("{} by {group}", NAMES[k]), forward, None, Some(tape), None, scale);
        }
        if k < 3 {
            let seen = loss.log_target.iter().chain(&rows[k][6..8]).filter(|x| **x != 0.0).count();
            f.residual("directions: derivatives by target depths that are not exactly 0", seen as f64, 0.0);
        }
    }
}

/// What a group's derivatives are measured by: the largest of a vector; for depths the sum of the sizes of all pixels, as their
/// signs cancel in the derivative of all together; for one pixel the mean of these sizes, where it is larger than its own.
fn scale_of(row: &[f64; pipeline::CHANGES], loss: &TapedLoss, columns: &Range<usize>) -> f64 {
    let largest = row[columns.clone()].iter().fold(0.0f64, |a, b| a.max(b.abs()));
    let depths = if columns.start < 8 { &loss.log_target } else { &loss.log_source };
    let sum: f64 = depths.iter().map(|x| x.abs()).sum();
    match columns.start {
        0 | 3 => largest,
        6 | 8 => sum,
        _ => largest.max(sum / depths.len() as f64),
    }
}

/// The groups that a loss depends on at all: directions do not see the target depth.
fn groups(loss: usize) -> impl Iterator<Item = (&'static str, Range<usize>)> {
    GROUPS.into_iter().filter(move |(_, columns)| loss > 2 || !(6..8).contains(&columns.start))
}

/// Central differences where float64 allows them, with steps that no kink of this scene lies within.
fn differences(estimate: &Perturbed, f: &mut Findings) {
    let rows = derivatives(estimate);
    let steps = [1e-6, 1e-6, 1e-8, 1e-8, 1e-8];
    for (k, (options, form)) in forms().into_iter().enumerate() {
        let loss = estimates::taped_loss(estimate, &options, form);
        let central = forward::central([0.0; pipeline::CHANGES], [steps[k]; pipeline::CHANGES], |x| {
            [pipeline::losses(estimate, PIXEL, x)[k]]
        });
        // One pixel's share of a mean is too small for a difference.
        for (group, columns) in groups(k).filter(|(_, columns)| columns.len() == 3 || columns.start % 2 == 0) {
            let scale = scale_of(&rows[k], &loss, &columns);
            let (forward, central) = (&rows[k][columns.clone()], &central[columns]);
            f.derivative(&format!("{} by {group}", NAMES[k]), forward, None, None, Some(central), scale);
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::ledger::testing::holds;

    proptest! {
        #[test]
        fn forward_mode_and_tape_agree(number in 0usize..6, x in prop::array::uniform8(-1.0f64..1.0)) {
            holds(|f| at(&Perturbed::drawn(&scenes::references()[number], &x), f))?;
        }
    }
}
