//! L01: intrinsics.

use nalgebra::{Vector2, Vector3};

use crate::ledger::{Case, Claim, Findings, Trial, Verdict};
use crate::scenes;

pub(super) static CLAIM: Claim = Claim {
    id: "L01",
    slug: "intrinsics",
    place: "eq. intrinsic_matrix",
    statement: "The viewing ray of a pixel is K^-1 (u, v, 1) = ((u - u0) / f_u, (v - v0) / f_v, 1); one K without skew for both \
         views.",
    verdict: Verdict::Exact,
    condition: Some("f_u f_v != 0"),
    formula: "K = [[f_u, 0, u0], [0, f_v, v0], [0, 0, 1]],  b(p) = K^-1 p~",
    derivation: "Multiply out: K b(p) = (f_u (u - u0) / f_u + u0, f_v (v - v0) / f_v + v0, 1).",
    counter_example: None,
    correction: None,
    functions: &["camera::Intrinsics::ray", "camera::Intrinsics::matrix", "camera::Intrinsics::inverse_matrix"],
    taped: &[],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    let ray = scenes::kitti640().ray(451.0, 63.0);
    trial.findings.documented("ray of pixel (451, 63), documented", ray.x, 0.352909482759, 1e-11);
    trial.findings.documented("ray of pixel (451, 63), documented", ray.y, -0.0895182291667, 1e-11);
}

fn at(case: &Case, f: &mut Findings) {
    let (camera, p) = (&case.camera, case.pixel);
    let homogeneous = Vector3::new(p.x, p.y, 1.0);
    let ray = camera.ray(p.x, p.y);
    let size = homogeneous.norm();
    f.residual("K b(p) - p~, relative", (camera.matrix() * ray - homogeneous).norm() / size, 1e-12);
    f.residual("K^-1 p~ - b(p), relative", (camera.inverse_matrix() * homogeneous - ray).norm() / ray.norm(), 1e-12);
    let back = camera.project(&(ray * case.depth)).unwrap_or(Vector2::repeat(f64::NAN));
    f.residual("projection of z b(p) - p, px", (back - p).norm(), 1e-10);
}

#[cfg(test)]
mod tests {
    crate::ledger::testing::tests_on_cases!(super::at);
}
