//! L58: the translation recovered from noisy flow.

use nalgebra::Vector2;

use crate::ledger::{Case, Claim, Findings, Trial, Verdict};
use crate::ratio_bias::{CUT, radial_recovery_bias, radial_recovery_bias_second_order, truncated_mean, truncated_variance};
use crate::ratios::inverse_tangential_ratios;

pub(super) static CLAIM: Claim = Claim {
    id: "L58",
    slug: "recovery-bias",
    place: "eqs. lt, lr, second terms",
    statement: "Averaging z / rho over the pixels removes the noise of the flow.",
    verdict: Verdict::Conditional,
    condition: Some("x and y always; z only away from p0: the bias falls as 1 / r^2"),
    formula: "E[z / rho_x] = t_x;  E[z / rho_z] - t_z = z sigma^2 / r^2 ((z + t_z) / z)^3 to second order",
    derivation: "z / rho_x = z f_x / f_u is linear in the flow: zero-mean noise has zero mean. z / rho_z = -z f_r / (r + f_r) \
                 curves: half its second derivative z r / (r + f_r)^3 times the variance is left, with r + f_r = r z / (z + \
                 t_z). It is positive for either sign of t_z: it shrinks |t_z| when t_z < 0, grows it when t_z > 0.",
    counter_example: Some(
        "sigma = 0.5 px (truncated at 3 sigma), z = 20 m, t_z = -0.8 m: bias 1.308 m at r = 2 px, 0.0108 m at 20 px, 0.00043 m \
         at 100 px.",
    ),
    correction: Some("Leave out pixels with r < 10..20 px, or weight by r^2."),
    functions: &[
        "ratios::inverse_tangential_ratios",
        "ratio_bias::radial_recovery_bias",
        "ratio_bias::radial_recovery_bias_second_order",
    ],
    taped: &["losses::tangential", "losses::radial"],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    for (r, expected) in [(2.0, 1.3081163722), (20.0, 0.0107814412267), (100.0, 0.000430600426754)] {
        let bias = radial_recovery_bias(0.5, 20.0, -0.8, r);
        trial.findings.documented("bias of t_z at z = 20 m, t_z = -0.8 m, documented", bias, expected, 1e-10);
    }
    let near = radial_recovery_bias(0.5, 20.0, -0.8, 2.0);
    trial.findings.gap("bias of t_z at r = 2 px, m", near, 0.9 * 1.308);
    let second = radial_recovery_bias_second_order(truncated_variance(0.5), 20.0, -0.8, 2.0);
    trial.findings.gap("bias at r = 2 px - its second order, m", near - second, 0.9 * 0.2317);
}

fn at(case: &Case, f: &mut Findings) {
    let sigma = case.extra(0, 0.1, 1.0);
    tangential(case, sigma, f);
    let (z, t_z, r) = (case.depth, case.motion.translation.z, case.offset().norm());
    // Where the noisy flow can end on p0, r + f_r + n = 0, the mean does not exist.
    let left = r * z / (z + t_z);
    if left > (CUT + 0.5) * sigma {
        radial(sigma, [z, t_z, r], left, f);
    }
}

/// `z / rho_x`, `z / rho_y`: linear in the flow.
fn tangential(case: &Case, sigma: f64, f: &mut Findings) {
    let (camera, z) = (&case.camera, case.depth);
    let flow = Vector2::new(case.extra(1, -50.0, 50.0), case.extra(2, -50.0, 50.0));
    let other = Vector2::new(case.extra(3, -5.0, 5.0), case.extra(4, -5.0, 5.0));
    let recovered = |flow: Vector2<f64>| inverse_tangential_ratios(camera, &flow) * z;
    let scale = recovered(Vector2::repeat(50.0)).norm();
    let sum = recovered(flow) + recovered(other) - recovered(flow + other);
    f.residual("z / rho_xy of a sum of flows - sum of z / rho_xy, relative", sum.norm() / scale, 1e-12);
    for k in 0..2 {
        let mean = truncated_mean(sigma, |n| recovered(flow + Vector2::repeat(n))[k]);
        f.residual("bias of t_x, t_y, relative", (mean - recovered(flow)[k]) / scale, 1e-12);
    }
}

/// The bias against its moments: second order, fourth order, and the bound of what follows.
fn radial(sigma: f64, [z, t_z, r]: [f64; 3], left: f64, f: &mut Findings) {
    let bias = radial_recovery_bias(sigma, z, t_z, r);
    let (variance, fourth) = (truncated_variance(sigma), truncated_mean(sigma, |n| n.powi(4)));
    let second = radial_recovery_bias_second_order(variance, z, t_z, r);
    f.floor("bias over its second order, which is positive", bias / second, 1.0 - 1e-11);
    // Even moments only: bias / second = 1 + m4 / (v R^2) + m6 / (v R^4) + ...; each further term is smaller by (3 sigma / R)^2.
    let next = fourth / (variance * left * left);
    let bound = next * (CUT * sigma / left).powi(2) / (1.0 - (CUT * sigma / left).powi(2));
    let excess = bias / second - 1.0 - next;
    f.floor("bias - its fourth order, relative to its second", excess, -1e-11);
    f.bound("bias - its fourth order - bound of the rest, relative to its second order", excess - bound, 1e-11);
    if left > 30.0 * sigma {
        f.bound("from 30 sigma on: bias over its second order - 1", bias / second - 1.0, 0.0035);
    }
}

#[cfg(test)]
mod tests {
    crate::ledger::testing::tests_on_cases!(super::at);
}
