//! L54: the aggregated terms of the ratio losses.

use dimode_autodiff::proof::{Dual, Number};

use crate::alignment::Convention;
use crate::ledger::estimates::{self, Form};
use crate::ledger::forward::{self, pipeline};
use crate::ledger::{Claim, Findings, Trial, Verdict};
use crate::loss_forms::{radial, tangential};
use crate::losses::{self, LossOptions};
use crate::scenes::{self, Perturbed, Reference};

pub(super) static CLAIM: Claim = Claim {
    id: "L54",
    slug: "cycle",
    place: "eqs. lt, lr, second and fourth terms",
    statement: "The aggregated terms close a cycle: the translation recovered from flows and depths must be the predicted one.",
    verdict: Verdict::Exact,
    condition: Some("flows exact and t_hat = t'"),
    formula: "|(E[z_hat / rho_k] - t'_k) / t'_k| = |E[z_hat / z] - 1|,  the same for k = x, y, z",
    derivation: "E[z_hat / rho_k] = t'_k E[z_hat / z] (L53); divide by t'_k. The term sees the mean of the SIGNED relative \
                 depth error: errors of opposite sign cancel, which the pixel terms E[|z_hat - z| / z_hat] do not allow.",
    counter_example: None,
    correction: None,
    functions: &[
        "loss_forms::ratio_terms::aggregate_term",
        "loss_forms::tangential::printed_terms",
        "loss_forms::radial::printed_terms",
    ],
    taped: &["taped::align", "losses::tangential", "losses::radial"],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    let references = scenes::references();
    for i in 0..(trial.samples / 100).max(6) {
        let x = std::array::from_fn(|_| trial.draw.unit());
        let reference = &references[i % references.len()];
        at(reference, &x, &mut trial.findings);
        by_log_depth(&wavy(reference, &x), &mut trial.findings);
        trial.count(reference.scene.pixels.len());
    }
    let handheld = Perturbed::exact(&scenes::handheld()).with_target_depths(|p| 1.02 + 0.1 * scenes::target_wave(p));
    by_log_depth(&handheld, &mut trial.findings);
    for [pixel, aggregate] in terms(&handheld) {
        trial.findings.documented("pixel term of handheld with wavy depths, documented", pixel, 0.0629791460404, 1e-11);
        trial.findings.documented("aggregate term of the same, documented", aggregate, 0.020396160715, 1e-11);
    }
    let cancelled = handheld.scaled(1.0 / mean_quotient(&handheld), 1.0, 1.0);
    for [pixel, aggregate] in terms(&cancelled) {
        let what = "errors of 10 % that cancel: what only the pixel term sees, pixel term - aggregate term";
        trial.findings.gap(what, pixel - aggregate, 0.05);
    }
}

/// Pixel and aggregate term of all three axes.
fn terms(estimate: &Perturbed) -> [[f64; 2]; 3] {
    let (camera, depths, a) = (&estimate.scene.camera, &estimate.target_depths, &estimate.in_target);
    let [p_x, a_x, p_y, a_y] = tangential::printed_terms(camera, &estimate.planar_flows(), depths, a);
    [[p_x, a_x], [p_y, a_y], radial::printed_terms(&estimate.axial_flows(), &estimate.scene.offsets(), depths, a)]
}

/// Depths with errors in waves.
fn wavy(reference: &Reference, x: &[f64; 3]) -> Perturbed {
    let (height, shift) = (0.05 + 0.3 * x[0], 0.5 + x[1]);
    Perturbed::exact(reference).with_target_depths(|p| shift + height * scenes::target_wave(p))
}

/// `E[z_hat / z]`.
fn mean_quotient(estimate: &Perturbed) -> f64 {
    let quotients = estimate.target_depths.iter().zip(&estimate.scene.depths).map(|(a, b)| a / b);
    quotients.sum::<f64>() / estimate.target_depths.len() as f64
}

fn at(reference: &Reference, x: &[f64; 3], f: &mut Findings) {
    let (exact, wavy, constant) = (Perturbed::exact(reference), wavy(reference, x), 0.2 + 3.0 * x[2]);
    let mean = mean_quotient(&wavy);
    let quotients = wavy.target_depths.iter().zip(&wavy.scene.depths).map(|(a, b)| a / b);
    let absolute = quotients.map(|q| (1.0 / q - 1.0).abs()).sum::<f64>() / wavy.target_depths.len() as f64;
    for [pixel, aggregate] in terms(&wavy) {
        f.residual("aggregate term - |E[z_hat / z] - 1|", aggregate - (mean - 1.0).abs(), 1e-12);
        f.residual("pixel term - E[|z - z_hat| / z_hat]", pixel - absolute, 1e-11);
    }
    for [_, aggregate] in terms(&exact.scaled(constant, 1.0, 1.0)) {
        f.residual("depths times c: aggregate term - |c - 1|", aggregate - (constant - 1.0).abs(), 1e-12);
    }
    let cancelled = wavy.scaled(1.0 / mean, 1.0, 1.0);
    for [pixel, aggregate] in terms(&cancelled) {
        f.residual("errors that cancel: aggregate term", aggregate, 1e-12);
        f.floor("errors that cancel: pixel term", pixel, 0.02);
    }
}

/// The aggregate terms by the logarithm of all target depths: `sign(E[z_hat / z] - 1) E[z_hat / z]`.
fn by_log_depth(wavy: &Perturbed, f: &mut Findings) {
    let mean = mean_quotient(wavy);
    // The term has its kink where the errors cancel.
    if (mean - 1.0).abs() < 0.01 {
        return;
    }
    let closed = [(mean - 1.0).signum() * mean; 3];
    let forward = forward::jacobian([0.0], |[x]: [Dual; 1]| aggregates(wavy, x));
    let central = forward::central([0.0], [1e-3], |[x]: [f64; 1]| aggregates(wavy, x));
    let options = LossOptions { convention: Convention::Consistent, ..LossOptions::literal() };
    let camera = wavy.scene.grid_camera();
    let tape = [0, 1, 2].map(|k| {
        let scale = 1.0 / wavy.in_target[k];
        let loss = estimates::taped(wavy, &options, |pair, _| {
            estimates::recovered(pair, &camera, k).scale(scale).add_scalar(-1.0).abs()
        });
        loss.log_target.iter().sum::<f64>()
    });
    f.derivative("d(aggregate term) / d log z_hat", &closed, Some(&forward), Some(&tape), Some(&central), mean);
    losses_on_the_tape(wavy, &options, f);
}

/// `L_tan` and `L_rad` as printed are the sums of their terms.
fn losses_on_the_tape(wavy: &Perturbed, options: &LossOptions, f: &mut Findings) {
    let [x, y, z] = terms(wavy).map(|[pixel, aggregate]| pixel + aggregate);
    let value = |form: Form| estimates::taped_loss(wavy, options, form).value;
    f.residual("L_tan on the tape - its four terms", value(losses::tangential) - (x + y), 1e-10);
    f.residual("L_rad on the tape - its two terms", value(losses::radial) - z, 1e-10);
}

/// Aggregate terms of all axes when the logarithm of all target depths changes by `x`, to first order.
fn aggregates<N: Number>(estimate: &Perturbed, x: N) -> [N; 3] {
    let mut changes = [N::zero(); pipeline::CHANGES];
    changes[6] = x;
    let recovered = pipeline::recovered_translation(estimate, 0, changes);
    std::array::from_fn(|k| (recovered[k] / N::constant(estimate.in_target[k]) - N::one()).abs())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::ledger::testing::holds;

    proptest! {
        #[test]
        fn holds_in_every_scene(number in 0usize..6, x in prop::array::uniform3(0.0f64..1.0)) {
            let reference = &scenes::references()[number];
            holds(|f| {
                at(reference, &x, f);
                by_log_depth(&wavy(reference, &x), f);
            })?;
        }
    }
}
