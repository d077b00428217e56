//! L09: the expansion of the quadratic terms in the text after eq. `rotational_flow`.

use nalgebra::{Matrix3, Vector2, Vector3};

use crate::flow::rotational::{printed_quadratic_terms, quadratic_terms};
use crate::homography::rotation_homography;
use crate::ledger::{Case, Claim, Findings, Trial, Verdict};
use crate::{scenes, so3};

pub(super) static CLAIM: Claim = Claim {
    id: "L09",
    slug: "rot-flow-inline",
    place: "text after eq. rotational_flow",
    statement: "The quadratic terms of eq. rotational_flow are h_31 u^2 + h_32 u v + h_33 u and h_31 u v + h_32 v^2 + h_33 v.",
    verdict: Verdict::Fails,
    condition: None,
    formula: "p~^T (-h_3 i_k^T) p~ = -(h_3 . p~) p_k",
    derivation: "(h_3 . p~) = h_31 u + h_32 v + h_33, and i_1 . p~ = u, i_2 . p~ = v; the leading minus of the matrix stays.",
    counter_example: Some(
        "K of kitti640, omega = (0.03, -0.05, 0.02), p = (451, 63): the terms are (-457.044, -63.844), printed (457.044, \
         63.844); with the printed signs the flow would be (882.567, 117.839) px instead of (-19.433, -8.161) px.",
    ),
    correction: Some("Both expansions need a minus in front."),
    functions: &["flow::rotational::quadratic_terms", "flow::rotational::printed_quadratic_terms"],
    taped: &[],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    let h = rotation_homography(&scenes::kitti640(), &so3::exp(&Vector3::new(0.03, -0.05, 0.02)));
    let p = Vector2::new(451.0, 63.0);
    let (terms, printed) = (quadratic_terms(&h, &p), printed_quadratic_terms(&h, &p));
    for (k, expected) in [-457.044111215, -63.8442993493].into_iter().enumerate() {
        trial.findings.documented("terms at (451, 63), documented", terms[k], expected, 1e-10);
        trial.findings.documented("printed terms at (451, 63), documented", printed[k], -expected, 1e-10);
    }
    trial.findings.gap(
        "flow with the printed signs - flow, px",
        (printed - terms).norm() / (h.row(2) * homogeneous(&p))[0],
        900.0,
    );
}

fn homogeneous(p: &Vector2<f64>) -> Vector3<f64> {
    Vector3::new(p.x, p.y, 1.0)
}

/// The quadratic form as a product of matrices, component by component.
fn quadratic_form(h: &Matrix3<f64>, p: &Vector2<f64>) -> Vector2<f64> {
    let x = homogeneous(p);
    let form = |k: usize| {
        let mut unit = Vector3::zeros();
        unit[k] = 1.0;
        (x.transpose() * (-h.row(2).transpose() * unit.transpose()) * x)[0]
    };
    Vector2::new(form(0), form(1))
}

fn at(case: &Case, f: &mut Findings) {
    let h = rotation_homography(&case.camera, &case.motion.rotation);
    let (form, terms) = (quadratic_form(&h, &case.pixel), quadratic_terms(&h, &case.pixel));
    let scale = 1.0 + form.norm();
    f.residual("expansion with the minus - quadratic form, relative", (terms - form).norm() / scale, 1e-12);
    let printed = printed_quadratic_terms(&h, &case.pixel);
    f.residual("printed expansion + quadratic form, relative", (printed + form).norm() / scale, 1e-12);
}

#[cfg(test)]
mod tests {
    crate::ledger::testing::tests_on_cases!(super::at);
}
