//! L54: the aggregated terms of the ratio losses.

use crate::ledger::{Claim, Findings, Trial, Verdict};
use crate::loss_forms::{radial, tangential};
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
    taped: &["losses::tangential", "losses::radial"],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    let references = scenes::references();
    for i in 0..(trial.samples / 100).max(6) {
        let x = std::array::from_fn(|_| trial.draw.unit());
        let reference = &references[i % references.len()];
        at(reference, &x, &mut trial.findings);
        trial.count(reference.scene.pixels.len());
    }
    let wavy = Perturbed::exact(&scenes::handheld()).with_target_depths(|p| 1.02 + 0.1 * scenes::target_wave(p));
    for [pixel, aggregate] in terms(&wavy) {
        trial.findings.documented("pixel term of handheld with wavy depths, documented", pixel, 0.0629791460404, 1e-11);
        trial.findings.documented("aggregate term of the same, documented", aggregate, 0.020396160715, 1e-11);
    }
}

/// Pixel and aggregate term of all three axes.
fn terms(estimate: &Perturbed) -> [[f64; 2]; 3] {
    let (camera, depths, a) = (&estimate.scene.camera, &estimate.target_depths, &estimate.in_target);
    let [p_x, a_x, p_y, a_y] = tangential::printed_terms(camera, &estimate.planar_flows(), depths, a);
    [[p_x, a_x], [p_y, a_y], radial::printed_terms(&estimate.axial_flows(), &estimate.scene.offsets(), depths, a)]
}

fn at(reference: &Reference, x: &[f64; 3], f: &mut Findings) {
    let (height, shift, constant) = (0.05 + 0.3 * x[0], 0.5 + x[1], 0.2 + 3.0 * x[2]);
    let exact = Perturbed::exact(reference);
    let wavy = exact.clone().with_target_depths(|p| shift + height * scenes::target_wave(p));
    let quotients: Vec<f64> = wavy.target_depths.iter().zip(&wavy.scene.depths).map(|(a, b)| a / b).collect();
    let count = quotients.len() as f64;
    let mean = quotients.iter().sum::<f64>() / count;
    let absolute = quotients.iter().map(|q| (1.0 / q - 1.0).abs()).sum::<f64>() / count;
    for [pixel, aggregate] in terms(&wavy) {
        f.residual("aggregate term - |E[z_hat / z] - 1|", aggregate - (mean - 1.0).abs(), 1e-12);
        f.residual("pixel term - E[|z - z_hat| / z_hat]", pixel - absolute, 1e-11);
    }
    for [_, aggregate] in terms(&exact.scaled(constant, 1.0, 1.0)) {
        f.residual("depths times c: aggregate term - |c - 1|", aggregate - (constant - 1.0).abs(), 1e-12);
    }
    let cancelled = exact.with_target_depths(|p| (shift + height * scenes::target_wave(p)) / mean);
    for [pixel, aggregate] in terms(&cancelled) {
        f.residual("errors that cancel: aggregate term", aggregate, 1e-12);
        f.gap("errors that cancel: pixel term", pixel, 0.02);
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::ledger::testing::holds;

    proptest! {
        #[test]
        fn holds_in_every_scene(number in 0usize..6, x in prop::array::uniform3(0.0f64..1.0)) {
            holds(|f| at(&scenes::references()[number], &x, f))?;
        }
    }
}
