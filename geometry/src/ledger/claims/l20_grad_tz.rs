//! L20: derivative of the flow with respect to the radial translation.

use nalgebra::{Vector2, Vector3};

use crate::flow::gradients::translational_gradients;
use crate::ledger::flow_derivatives::{self, Input};
use crate::ledger::{Case, Claim, Findings, Trial, Verdict};
use crate::scenes;

pub(super) static CLAIM: Claim = Claim {
    id: "L20",
    slug: "grad-tz",
    place: "eq. grad_tz",
    statement: "df/dt_z = -[d z + f o t] / (z + t_z)^2.",
    verdict: Verdict::Exact,
    condition: Some("R = I; with a rotation the same with the rotated pixel and depth"),
    formula: "df/dt_z = -[d z + f o t] / (z + t_z)^2,  d = p - p0, f o t = (f_u t_x, f_v t_y); with rotation d = p_R - p0 and \
         z_R for z",
    derivation: "Quotient rule on f = [f o t - d t_z] / (z + t_z): [-d (z + t_z) - f o t + d t_z] / (z + t_z)^2.",
    counter_example: None,
    correction: None,
    functions: &["flow::gradients::translational_gradients", "flow::gradients::rigid_gradients"],
    taped: &["taped::rigid_flow", "taped::so3_exp"],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    let (camera, t) = (scenes::kitti640(), Vector3::new(0.3, -0.1, 0.6));
    let gradient = translational_gradients(&camera, &t, &Vector2::new(451.0, 63.0), 12.5).map(|g| g.t_z);
    for (k, expected) in [-10.1908979663, 2.61851873434].into_iter().enumerate() {
        trial.findings.documented("gradient at (451, 63), documented", gradient.map_or(f64::NAN, |g| g[k]), expected, 1e-10);
    }
}

fn at(case: &Case, f: &mut Findings) {
    flow_derivatives::compare(case, f, "df/dt_z", &[(Input::Radial, |g| g.t_z)]);
}

#[cfg(test)]
mod tests {
    crate::ledger::testing::tests_on_cases!(super::at);
}
