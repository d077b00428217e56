//! L24: the two rows of eq. `residual_rot`.

use nalgebra::Vector3;

use crate::deviation::{partly_moved_points, residual_products, residual_rows};
use crate::ledger::{Case, Claim, Findings, Trial, Verdict, forward};
use crate::motion::{radial_part, tangential_part};
use crate::se3::Se3;
use crate::so3;

pub(super) static CLAIM: Claim = Claim {
    id: "L24",
    slug: "residual-rows",
    place: "fig. practicaltransformation, eq. residual_rot",
    statement: "Estimates R_hat, t_hat leave [dR^-1, (I - dR^-1) t_tan - dR^-1 dt_tan] beside T_rad and \
         [dR^-1, (I - dR^-1) t_rad - dR^-1 dt_rad] beside T_tan, with dR = R_hat R^-1 and dt = t_hat - t.",
    verdict: Verdict::Exact,
    condition: Some("the estimate is undone on the right of T; eq. pplanar does something else (L28), correction B leaves L34"),
    formula: "T_rad^-1 T T_hat_rot^-1 T_hat_tan^-1 and T_tan^-1 T T_hat_rot^-1 T_hat_rad^-1",
    derivation: "T T_hat_rot^-1 = [dR^-1, t]. Times [I, -t_hat_tan] on the right: [dR^-1, t - dR^-1 t_hat_tan]; times [I, \
         -t_rad] on the left: [dR^-1, t_tan - dR^-1 (t_tan + dt_tan)]. With T from source to target this is the procedure of \
         the text: turn the source points by R_hat and add the estimated part; then P_t = T_rad dT_rad P_s'.",
    counter_example: None,
    correction: None,
    functions: &["deviation::residual_rows", "deviation::residual_products", "deviation::partly_moved_points"],
    taped: &[],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    let pose = |w: [f64; 3], t: [f64; 3]| Se3::from_rotation_vector(&w.into(), t.into());
    let truth = pose([0.03, -0.05, 0.02], [0.06, 0.04, -0.08]);
    let rows = residual_rows(&truth, &pose([0.032, -0.047, 0.021], [0.066, 0.037, -0.085]));
    let expected =
        [-0.00604025359731, 0.00307211200459, -0.000126463439953, -0.000255218534859, 0.0001653323136, 0.00499945604959];
    let found = rows.radial.translation.iter().chain(rows.tangential.translation.iter());
    for (&found, expected) in found.zip(expected) {
        trial.findings.documented("translations of both rows, documented", found, expected, 1e-11);
    }
}

/// The case's motion with errors of up to 0.05 rad and 30 % of each component.
pub(super) fn estimate(case: &Case) -> Se3 {
    let turn = so3::exp(&(case.extra_direction(0) * case.extra(2, 0.0, 0.05)));
    let stretch = Vector3::from_fn(|k, _| case.extra(3 + k, 0.7, 1.3));
    Se3 { rotation: turn * case.motion.rotation, translation: case.motion.translation.component_mul(&stretch) }
}

fn at(case: &Case, f: &mut Findings) {
    let (truth, guess) = (case.motion, estimate(case));
    let (rows, products) = (residual_rows(&truth, &guess), residual_products(&truth, &guess));
    let scale = 1.0 + truth.translation.norm();
    let distance = |a: &Se3, b: &Se3| ((a.rotation - b.rotation).amax() + (a.translation - b.translation).norm()) / scale;
    f.residual("row beside T_rad - product of motions", distance(&rows.radial, &products.radial), 1e-13);
    f.residual("row beside T_tan - product of motions", distance(&rows.tangential, &products.tangential), 1e-13);
    procedure(case, &guess, f);
}

/// The procedure on a point: `P_t = T_rad dT_rad (R_hat P_s + tan(t_hat))`, the left side by the power series.
fn procedure(case: &Case, guess: &Se3, f: &mut Findings) {
    let (truth, point) = (case.motion, case.point());
    let w = so3::log(&truth.rotation);
    let target = Vector3::from(forward::sum(forward::rotated::<f64>(w.into(), point.into()), truth.translation.into()));
    let rows = residual_rows(&truth, guess);
    let [after_tangential, after_radial] = partly_moved_points(guess, &point);
    let beside_radial = rows.radial.transform(&after_tangential) + radial_part(&truth.translation);
    let beside_tangential = rows.tangential.transform(&after_radial) + tangential_part(&truth.translation);
    let scale = 1.0 + point.norm();
    f.residual("target point - T_rad dT_rad P_s', relative", (beside_radial - target).norm() / scale, 1e-13);
    f.residual("target point - T_tan dT_tan P_s', relative", (beside_tangential - target).norm() / scale, 1e-13);
}

#[cfg(test)]
mod tests {
    crate::ledger::testing::tests_on_cases!(super::at);
}
