//! L53: the translation recovered from flows and depths.

use dimode_autodiff::proof::{Dual, Number};
use nalgebra::Vector3;

use crate::alignment::Convention;
use crate::ledger::forward::{self, pipeline};
use crate::ledger::{Claim, Findings, Trial, Verdict, estimates};
use crate::losses::LossOptions;
use crate::recovery;
use crate::scenes::{self, Perturbed, Reference};

pub(super) static CLAIM: Claim = Claim {
    id: "L53",
    slug: "recovery",
    place: "text after eq. constraint4",
    statement: "Dividing depth by the ratios gives the translation back: t = E[z / rho].",
    verdict: Verdict::Exact,
    condition: Some("flows exact; with estimated depth the result is t' E[z_hat / z]"),
    formula: "E[z_hat / rho_k] = t'_k E[z_hat / z],  k = x, y, z",
    derivation: "With exact flow 1 / rho_k = t'_k / z at every pixel, so that z_hat / rho_k = t'_k z_hat / z; the mean takes \
                 t'_k out.",
    counter_example: None,
    correction: None,
    functions: &["recovery::translation", "ratios::recovered_translation"],
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
    let documented = [0.0612237696429, 0.0408158464286, -0.0816316928572];
    let found = recovered(&Perturbed::exact(&scenes::handheld()).with_target_depths(|p| 1.02 + 0.1 * scenes::target_wave(p)));
    for k in 0..3 {
        trial.findings.documented("recovered t' of handheld with wavy depths, documented", found[k], documented[k], 1e-11);
    }
}

/// Depths with errors in waves.
fn wavy(reference: &Reference, x: &[f64; 3]) -> Perturbed {
    let (height, shift) = (0.3 * x[0], 0.5 + x[1]);
    Perturbed::exact(reference).with_target_depths(|p| shift + height * scenes::target_wave(p))
}

fn recovered(estimate: &Perturbed) -> Vector3<f64> {
    let (planar, axial) = (estimate.planar_flows(), estimate.axial_flows());
    let scene = &estimate.scene;
    recovery::translation(&scene.camera, [&planar, &axial], &scene.offsets(), &estimate.target_depths)
}

/// A scene with depth errors in waves, and the same times a constant.
fn at(reference: &Reference, x: &[f64; 3], f: &mut Findings) {
    let (wavy, constant) = (wavy(reference, x), 0.2 + 3.0 * x[2]);
    let truth = wavy.in_target;
    let quotients = wavy.target_depths.iter().zip(&wavy.scene.depths).map(|(a, b)| a / b);
    let mean = quotients.sum::<f64>() / wavy.target_depths.len() as f64;
    let found = recovered(&wavy);
    let miss = (found - truth * mean).norm() / (truth.norm() * mean);
    f.residual("E[z_hat / rho] - t' E[z_hat / z], relative to |t'|", miss, 1e-12);
    let scaled = recovered(&wavy.scaled(constant, 1.0, 1.0));
    let miss = (scaled / constant - found).norm() / found.norm();
    f.residual("depths times c: recovered translation over c, relative", miss, 1e-12);
    let exact = recovered(&Perturbed::exact(reference));
    f.residual("true depths: recovered translation - t', relative", (exact - truth).norm() / truth.norm(), 1e-12);
}

/// By the logarithm of all target depths: linear in them, so that the derivative is what is recovered.
fn by_log_depth(estimate: &Perturbed, f: &mut Findings) {
    let closed = recovered(estimate);
    let forward = forward::jacobian([0.0], |[x]: [Dual; 1]| changed(estimate, x));
    let central = forward::central([0.0], [1e-3], |[x]: [f64; 1]| changed(estimate, x));
    let options = LossOptions { convention: Convention::Consistent, ..LossOptions::literal() };
    let camera = estimate.scene.grid_camera();
    let taped = [0, 1, 2].map(|k| estimates::taped(estimate, &options, |pair, _| estimates::recovered(pair, &camera, k)));
    let values = Vector3::from_fn(|k, _| taped[k].value);
    f.residual("recovered translation on the tape - plain, relative", (values - closed).norm() / closed.norm(), 1e-12);
    let tape = taped.each_ref().map(|x| x.log_target.iter().sum::<f64>());
    let what = "d E[z_hat / rho] / d log z_hat";
    f.derivative(what, closed.as_slice(), Some(&forward), Some(&tape), Some(&central), closed.norm());
}

/// The recovered translation when the logarithm of all target depths changes by `x`, to first order.
fn changed<N: Number>(estimate: &Perturbed, x: N) -> [N; 3] {
    let mut changes = [N::zero(); pipeline::CHANGES];
    changes[6] = x;
    pipeline::recovered_translation(estimate, 0, changes)
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
