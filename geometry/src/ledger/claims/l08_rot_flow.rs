//! L08: flow of a pure rotation.

use nalgebra::{Vector2, Vector3};

use crate::flow::rotational::{quadratic_terms, rotational_flow};
use crate::homography::{rotation_homography, transfer};
use crate::ledger::{Case, Claim, Findings, Trial, Verdict, forward, taped};
use crate::{scenes, so3};

pub(super) static CLAIM: Claim = Claim {
    id: "L08",
    slug: "rot-flow",
    place: "eq. rotational_flow",
    statement: "f_k = [p~^T (-h_3 i_k^T) p~ + h_k . p~] / (h_3 . p~), k = 1, 2: a quadratic over a linear polynomial of the \
         pixel.",
    verdict: Verdict::Exact,
    condition: Some("h_3 . p~ > 0"),
    formula: "f_k = h_k . p~ / h_3 . p~ - p_k",
    derivation: "p~^T (-h_3 i_k^T) p~ = -(h_3 . p~) (i_k . p~) = -(h_3 . p~) p_k. Divide by h_3 . p~: what remains is the pixel \
                 of the homography minus the pixel.",
    counter_example: None,
    correction: None,
    functions: &["flow::rotational::rotational_flow", "flow::rotational::quadratic_terms"],
    taped: &["taped::rigid_flow", "taped::so3_exp"],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    let (camera, p) = (scenes::kitti640(), Vector2::new(451.0, 63.0));
    let rotation = so3::exp(&Vector3::new(0.03, -0.05, 0.02));
    let flow = rotational_flow(&camera, &rotation, &p).unwrap_or(Vector2::repeat(f64::NAN));
    let terms = quadratic_terms(&rotation_homography(&camera, &rotation), &p);
    for (k, [expected, quadratic]) in [[-19.4329111175, -457.044111215], [-8.16065596442, -63.8442993493]].into_iter().enumerate()
    {
        trial.findings.documented("flow at (451, 63), documented", flow[k], expected, 1e-11);
        trial.findings.documented("quadratic terms at (451, 63), documented", terms[k], quadratic, 1e-11);
    }
}

fn at(case: &Case, f: &mut Findings) {
    let (camera, rotation, p) = (&case.camera, &case.motion.rotation, case.pixel);
    let Some(flow) = rotational_flow(camera, rotation, &p) else {
        return f.residual("point in front of the source camera", f64::NAN, 1.0);
    };
    let h = rotation_homography(camera, rotation);
    let image = transfer(&h, &p).map_or(Vector2::repeat(f64::NAN), |(image, _)| image);
    f.residual("flow - (pixel of the homography - p), px", (flow - (image - p)).norm(), 1e-10);
    let omega = so3::log(rotation);
    let depth = case.extra(0, 0.5, 80.0);
    let (other, _) = forward::rigid_flow::<f64>(camera, omega.into(), [0.0; 3], p.into(), depth);
    f.residual("flow - full projection at any depth, px", (flow - Vector2::from(other)).norm(), 1e-10);
    let (taped, _) = taped::rigid_flow(camera, &omega, &Vector3::zeros(), &p, depth);
    f.residual("flow - flow on the tape, px", (flow - Vector2::new(taped[0], taped[1])).norm(), 1e-10);
}

#[cfg(test)]
mod tests {
    crate::ledger::testing::tests_on_cases!(super::at);
}
