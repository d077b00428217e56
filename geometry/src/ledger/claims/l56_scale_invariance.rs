//! L56: a common scale of depths and translation is unobservable.

use nalgebra::Vector2;

use crate::Se3;
use crate::alignment::Convention;
use crate::flow::rigid::rigid_flow;
use crate::ledger::estimates::{self, Clearance, Form, PlainLosses, TapedLoss};
use crate::ledger::{Claim, Findings, Trial, Verdict};
use crate::losses::{self, LossOptions};
use crate::scenes::{self, Perturbed};

pub(super) static CLAIM: Claim = Claim {
    id: "L56",
    slug: "scale-invariance",
    place: "eqs. lp, la, lt, lr",
    statement: "All four losses stay the same when target depth, source depth and translation are multiplied by one factor.",
    verdict: Verdict::Exact,
    condition: None,
    formula: "L(c z_t, c z_s, c t') = L(z_t, z_s, t');  sum z_t dL/dz_t + sum z_s dL/dz_s + t'.dL/dt' = 0",
    derivation: "Aligned flows are quotients of points whose coordinates all scale; the ratios have no unit, and the terms of \
                 L_tan, L_rad are relative. The derivative by c at c = 1 is Euler's identity. L_pla removes only t'_z and reads \
                 no target depth, so it depends on (z_s : t'_z) alone, L_axi likewise on (z_s : t'_x : t'_y). The photometric \
                 loss warps by the rigid flow, which is a quotient too: a monocular network cannot know the scale.",
    counter_example: None,
    correction: None,
    functions: &[
        "loss_forms::planar::printed",
        "loss_forms::axial::printed",
        "loss_forms::tangential::printed",
        "loss_forms::radial::printed",
        "ledger::estimates::PlainLosses::new",
        "ledger::estimates::taped_loss",
    ],
    taped: &["losses::planar::planar", "losses::axial::axial", "losses::tangential::tangential", "losses::radial::radial"],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    let references = scenes::references();
    for i in 0..(trial.samples / 100).max(6) {
        let x: [f64; 8] = std::array::from_fn(|_| trial.draw.uniform(-1.0, 1.0));
        let factor = trial.draw.log_uniform(0.1, 10.0);
        let estimate = Perturbed::drawn(&references[i % references.len()], &x);
        at(&estimate, factor, &mut trial.findings);
        trial.count(estimate.matches.len());
    }
    documented(&mut trial.findings);
}

fn documented(f: &mut Findings) {
    let estimate = scenes::perturbed_handheld();
    let chosen = |e: &Perturbed| {
        let all = PlainLosses::new(e);
        [all.planar[0], all.axial[0], all.tangential, all.radial]
    };
    let expected = [0.00307454563241, 0.431587222063, 1.01436951655, 1.15411828162];
    let alone = [0.0786559896294, 1.30474739028, 4.17674387342, 9.26798284033];
    for (k, name) in ["L_pla", "L_axi", "L_tan", "L_rad"].into_iter().enumerate() {
        for factor in [1.0, 1.7] {
            let found = chosen(&estimate.scaled(factor, factor, factor))[k];
            f.documented(&format!("{name} of perturbed handheld, factors 1 and 1.7, documented"), found, expected[k], 1e-11);
        }
        let found = chosen(&estimate.scaled(1.0, 1.0, 1.7))[k];
        f.documented(&format!("{name} with the translation alone times 1.7, documented"), found, alone[k], 1e-11);
        f.gap(&format!("{name}: change when the translation alone scales"), found - expected[k], 0.9 * (alone[k] - expected[k]));
    }
}

fn at(estimate: &Perturbed, factor: f64, f: &mut Findings) {
    let plain = PlainLosses::new(estimate).to_array();
    let scaled = PlainLosses::new(&estimate.scaled(factor, factor, factor)).to_array();
    let clear = Clearance::new(estimate);
    // Flows carry 1e-13 px of rounding, and a ratio divides by them.
    let divisible = clear.divisor > 1e-3;
    for (k, (a, b)) in plain.into_iter().zip(scaled).enumerate() {
        if k < 5 || divisible {
            let scale = (1.0 + a) * if k < 5 { 1.0 } else { clear.rounding() };
            f.equal("plain losses times a common factor, relative to 1 + L", b, a, scale, 1e-10);
        }
    }
    partial_scales(estimate, factor, &plain, f);
    rigid_flows(estimate, factor, f);
    let literal = LossOptions { convention: Convention::Consistent, ..LossOptions::literal() };
    let pixels = LossOptions { min_tangential_share: 0.0, detach_source_depth: false, ..LossOptions::default() };
    for (name, options) in [("printed", literal), ("pixel", estimates::on_the_grid(&pixels))] {
        let forms: [Form; 4] = [losses::planar, losses::axial, losses::tangential, losses::radial];
        // The derivative of arccos at the sine s carries rounding of 1e-16 / s^2.
        let printed = [clear.horizontal > 1e-4, clear.radial > 1e-4, divisible, divisible];
        for (k, form) in forms.into_iter().enumerate() {
            if printed[k] || name == "pixel" {
                let rounding = if k < 2 || name == "pixel" { 1.0 } else { clear.rounding() };
                euler((name, k), [factor, rounding], estimate, &options, form, f);
            }
        }
    }
}

/// The flow that the photometric loss warps by.
fn rigid_flows(estimate: &Perturbed, factor: f64, f: &mut Findings) {
    let rotation = estimate.rotation();
    let motion = |c: f64| Se3 { rotation, translation: rotation * estimate.in_target * c };
    let flow = |p: &Vector2<f64>, z: f64, c: f64| rigid_flow(&estimate.scene.camera, &motion(c), p, z * c).map(|(flow, _)| flow);
    for (p, &z) in estimate.scene.pixels.iter().zip(&estimate.target_depths).step_by(20) {
        let moved = flow(p, z, factor).zip(flow(p, z, 1.0)).map_or(f64::NAN, |(a, b)| (a - b).norm());
        f.residual("rigid flow times a common factor: change, px", moved, 1e-10);
    }
}

/// `L_pla` without `t'_x`, `t'_y`, `z_t`; `L_axi` without `t'_z`, `z_t`.
fn partial_scales(estimate: &Perturbed, factor: f64, plain: &[f64; 7], f: &mut Findings) {
    // Only upwards: a nearer point would come behind what the other alignment removes.
    let factor = factor.max(1.0 / factor);
    let scaled = |k: [f64; 3]| {
        let in_target = estimate.in_target.component_mul(&nalgebra::Vector3::from(k));
        PlainLosses::new(&Perturbed { in_target, ..estimate.scaled(1.0, factor, 1.0) }).to_array()
    };
    let (planar, axial) = (scaled([1.0, 1.0, factor]), scaled([factor, factor, 1.0]));
    for k in 0..3 {
        f.equal("L_pla with z_s, t'_z times a factor, relative to 1 + L", planar[k], plain[k], 1.0 + plain[k], 1e-10);
    }
    for k in 3..5 {
        f.equal("L_axi with z_s, t'_x, t'_y times a factor, relative to 1 + L", axial[k], plain[k], 1.0 + plain[k], 1e-10);
    }
}

/// Invariance and Euler's identity of one loss on the tape, and the identities of fewer unknowns of `L_pla` and `L_axi`.
fn euler(
    (name, k): (&str, usize),
    [factor, rounding]: [f64; 2],
    estimate: &Perturbed,
    options: &LossOptions,
    form: Form,
    f: &mut Findings,
) {
    let loss = estimates::taped_loss(estimate, options, form);
    let scaled = estimates::taped_loss(&estimate.scaled(factor, factor, factor), options, form);
    let what = format!("{name} forms on the tape times a common factor, relative to 1 + L");
    f.equal(&what, scaled.value, loss.value, (1.0 + loss.value) * rounding, 1e-10);
    let parts = parts(estimate, &loss);
    let size: f64 = parts.iter().map(|x| x.abs()).sum();
    let sum: f64 = parts.iter().sum();
    // A loss below its noise floor everywhere has no derivative at all.
    let relative = |sum: f64| if size == 0.0 { sum } else { sum / size };
    f.residual(&format!("{name} forms: Euler's sum, relative to the sizes of its parts"), relative(sum), 1e-9);
    // The pixel form of L_pla reads the predicted direction, that of every term its target depth.
    if name == "printed" && k < 2 {
        let [target, source, x, y, z] = parts;
        let fewer = [[source + z, target, x, y], [source + x + y, target, z, 0.0]][k];
        let what = ["L_pla: Euler's sum of z_s, t'_z; the others", "L_axi: Euler's sum of z_s, t'_x, t'_y; the others"][k];
        fewer.into_iter().for_each(|x| f.residual(what, relative(x), 1e-9));
    }
}

/// `sum z_t dL/dz_t`, `sum z_s dL/dz_s`, `t'_k dL/dt'_k`.
fn parts(estimate: &Perturbed, loss: &TapedLoss) -> [f64; 5] {
    let by_t = loss.in_target.component_mul(&estimate.in_target);
    [loss.log_target.iter().sum(), loss.log_source.iter().sum(), by_t.x, by_t.y, by_t.z]
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::ledger::testing::holds;

    proptest! {
        #[test]
        fn holds_for_any_estimates(number in 0usize..6, x in prop::array::uniform8(-1.0f64..1.0), log in -2.3f64..2.3) {
            let estimate = Perturbed::drawn(&scenes::references()[number], &x);
            holds(|f| at(&estimate, log.exp(), f))?;
        }
    }
}
