//! L59: the gradient of the pixel terms with respect to depth.

use dimode_autodiff::proof::Number;

use crate::ledger::{Case, Claim, Findings, Trial, Verdict, forward, taped};
use crate::loss_forms::ratio_terms::{pixel_term_at, pixel_term_log_slope, pixel_term_slope};

pub(super) static CLAIM: Claim = Claim {
    id: "L59",
    slug: "pixel-term-gradient",
    place: "text after eq. lr",
    statement: "The ratio losses give depth consistent gradients across the whole map.",
    verdict: Verdict::Conditional,
    condition: Some("with respect to log depth, near consistency, for exact ratios that are held fixed"),
    formula: "d/dz |rho t - z| / z = -sign(rho t - z) rho t / z^2;  d/dlog z = -sign(rho t - z) rho t / z",
    derivation: "For z < rho t the term is rho t / z - 1, for z > rho t it is 1 - rho t / z. The pixel's place does not enter; \
                 the depth does: near consistency the derivative by z is about -+ 1/z, that by log z about -+ 1. It has no \
                 bound for too small predictions and vanishes for too large ones. The dependence of rho on source depth and \
                 motion is left out.",
    counter_example: Some(
        "10 % too near: d/dz is -0.2469 / m at 5 m, -0.0617 at 20 m, -0.0206 at 60 m. At 20 m: -0.2 for z = 10 m, 0.0125 for z \
         = 40 m.",
    ),
    correction: Some("Uniform with respect to log depth (a network that predicts it, or inverse depth over a bounded range)."),
    functions: &[
        "loss_forms::ratio_terms::pixel_term_at",
        "loss_forms::ratio_terms::pixel_term_slope",
        "loss_forms::ratio_terms::pixel_term_log_slope",
    ],
    taped: &["losses::tangential", "losses::radial"],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    let f = &mut trial.findings;
    let table = [
        (10.0, -0.2, -2.0),
        (18.0, -0.0617283950617, -1.11111111111),
        (22.0, 0.0413223140496, 0.909090909091),
        (40.0, 0.0125, 0.5),
    ];
    for (z, slope, log_slope) in table {
        f.documented("derivatives at rho t = 20 m, documented", pixel_term_slope(20.0, z), slope, 1e-11);
        f.documented("derivatives at rho t = 20 m, documented", pixel_term_log_slope(20.0, z), log_slope, 1e-11);
    }
    let near_over_far = pixel_term_slope(5.0, 4.5) / pixel_term_slope(60.0, 54.0);
    f.gap("derivative by depth at 5 m over that at 60 m, - 1", near_over_far - 1.0, 0.9 * 11.0);
    let small_over_large = (pixel_term_log_slope(20.0, 10.0) / pixel_term_log_slope(20.0, 40.0)).abs();
    f.gap("derivative by log depth at half over that at twice the depth, - 1", small_over_large - 1.0, 0.9 * 3.0);
}

fn at(case: &Case, f: &mut Findings) {
    let depth = case.depth;
    let quotient = case.extra(0, 0.3, 3.0);
    // The kink lies at 1.
    if (0.999..=1.001).contains(&quotient) {
        return;
    }
    let z = quotient * depth;
    fn term<N: Number>(depth: f64, z: N) -> N {
        (N::constant(depth) - z).abs() / z
    }
    f.equal("the term by both implementations, relative", term(depth, z), pixel_term_at(depth, z), 1.0, 1e-12);
    let closed = pixel_term_slope(depth, z);
    let dual = forward::jacobian([z], |[z]| [term(depth, z)]);
    let central = forward::central([z], [1e-6 * z], |[z]| [term(depth, z)]);
    let (_, rows) = taped::jacobian(&[taped::column(&[z])], |v| {
        let target = v[0].tape().constant(taped::column(&[depth]));
        target.sub(v[0]).abs().div(v[0])
    });
    // Two terms of the quotient rule cancel to the derivative: their size is what rounding is measured against.
    let scale = (depth + z) / (z * z);
    f.derivative("d/dz of the pixel term", &[closed], Some(&dual), Some(&rows[0]), Some(&central), scale);
    let log_dual = forward::jacobian([0.0], |[x]| [term(depth, x.exp() * Number::constant(z))]);
    let log_central = forward::central([0.0], [1e-6], |[x]: [f64; 1]| [term(depth, x.exp() * z)]);
    let (_, log_rows) = taped::jacobian(&[taped::column(&[0.0])], |v| {
        let target = v[0].tape().constant(taped::column(&[depth]));
        let z = v[0].exp().scale(z);
        target.sub(z).abs().div(z)
    });
    let log_closed = pixel_term_log_slope(depth, z);
    f.derivative("d/dlog z of the pixel term", &[log_closed], Some(&log_dual), Some(&log_rows[0]), Some(&log_central), scale * z);
    f.equal("d/dlog z - z d/dz, relative", log_closed, z * closed, log_closed, 1e-13);
    // The same quotient at another depth: the derivative by log depth does not know it.
    let elsewhere = case.extra(1, 0.5, 80.0);
    let there = pixel_term_log_slope(elsewhere, quotient * elsewhere);
    f.equal("d/dlog z at the same quotient and another depth, relative", there, log_closed, log_closed, 1e-12);
}

#[cfg(test)]
mod tests {
    crate::ledger::testing::tests_on_cases!(super::at);
}
