//! L19: derivatives of the flow with respect to the tangential translation.

use nalgebra::{Vector2, Vector3};

use crate::flow::gradients::translational_gradients;
use crate::ledger::flow_derivatives::{self, Input};
use crate::ledger::{Case, Claim, Findings, Trial, Verdict};
use crate::scenes;

pub(super) static CLAIM: Claim = Claim {
    id: "L19",
    slug: "grad-tx-ty",
    place: "eqs. grad_tx, grad_ty",
    statement: "df/dt_x = (f_u, 0) / (z + t_z) and df/dt_y = (0, f_v) / (z + t_z).",
    verdict: Verdict::Exact,
    condition: Some("R = I; with a rotation the same with the rotated depth"),
    formula: "df/dt_x = (f_u, 0) / (z_R + t_z),  df/dt_y = (0, f_v) / (z_R + t_z),  z_R = z h_3 . p~ (= z for R = I)",
    derivation: "t_x and t_y enter f = [f o t - d t_z] / (z + t_z) once, linearly, in the numerator.",
    counter_example: None,
    correction: None,
    functions: &["flow::gradients::translational_gradients", "flow::gradients::rigid_gradients"],
    taped: &["taped::rigid_flow", "taped::so3_exp"],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    let (camera, t, p) = (scenes::kitti640(), Vector3::new(0.3, -0.1, 0.6), Vector2::new(451.0, 63.0));
    let [x, y] = translational_gradients(&camera, &t, &p, 12.5).map_or([f64::NAN; 2], |g| [g.t_x.x, g.t_y.y]);
    trial.findings.documented("gradients at (451, 63), documented", x, 28.3358778626, 1e-10);
    trial.findings.documented("gradients at (451, 63), documented", y, 28.1404580153, 1e-10);
}

fn at(case: &Case, f: &mut Findings) {
    flow_derivatives::compare(case, f, "df/dt_x, df/dt_y", &[(Input::TangentialX, |g| g.t_x), (Input::TangentialY, |g| g.t_y)]);
}

#[cfg(test)]
mod tests {
    crate::ledger::testing::tests_on_cases!(super::at);
}
