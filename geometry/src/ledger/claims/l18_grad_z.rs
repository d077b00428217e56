//! L18: derivative of the flow with respect to the depth.

use nalgebra::{Vector2, Vector3};

use crate::flow::gradients::{rigid_gradients, translational_gradients};
use crate::ledger::flow_derivatives::{self, Input};
use crate::ledger::{Case, Claim, Findings, Trial, Verdict};
use crate::scenes;
use crate::se3::Se3;

pub(super) static CLAIM: Claim = Claim {
    id: "L18",
    slug: "grad-z",
    place: "eq. grad_z",
    statement: "df/dz = -[f o t - d t_z] / (z + t_z)^2.",
    verdict: Verdict::Exact,
    condition: Some("R = I; with a rotation the same at the rotated pixel and depth, times h_3 . p~"),
    formula: "df/dz = -[f o t - d t_z] / (z + t_z)^2; with rotation -h [f o t - (p_R - p0) t_z] / (z_R + t_z)^2, h = h_3 . p~, \
         z_R = h z",
    derivation: "f = [f o t - d t_z] / (z + t_z): the numerator is free of z, so the derivative is minus the flow over z + t_z. \
         With rotation f = (p_R - p) + [f o t - (p_R - p0) t_z] / (z_R + t_z); p_R is free of z, and dz_R/dz = h_3 . p~.",
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
    let turning = Se3::from_rotation_vector(&Vector3::new(0.03, -0.05, 0.02), t);
    let straight = translational_gradients(&camera, &t, &p, 12.5).map_or(Vector2::repeat(f64::NAN), |g| g.z);
    let turned = rigid_gradients(&camera, &turning, &p, 12.5).map_or(Vector2::repeat(f64::NAN), |g| g.z);
    for (k, (without, with)) in [(-0.190897966319, -0.255727934023), (0.0994347648738, 0.0700498558718)].into_iter().enumerate() {
        trial.findings.documented("gradient at (451, 63), documented", straight[k], without, 1e-10);
        trial.findings.documented("gradient with rotation, documented", turned[k], with, 1e-10);
    }
}

fn at(case: &Case, f: &mut Findings) {
    flow_derivatives::compare(case, f, "df/dz", &[(Input::Depth, |g| g.z)]);
}

#[cfg(test)]
mod tests {
    crate::ledger::testing::tests_on_cases!(super::at);
}
