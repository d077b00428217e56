//! L34: what estimates leave over when the translation is split in the target frame.

use nalgebra::Vector3;

use super::l24_residual_rows::estimate;
use crate::alignment::unrotated_point;
use crate::deviation::{alignment_products, alignment_residual};
use crate::ledger::{Case, Claim, Findings, Trial, Verdict};
use crate::motion::{radial_part, tangential_part};
use crate::se3::Se3;

pub(super) static CLAIM: Claim = Claim {
    id: "L34",
    slug: "residual-target-frame",
    place: "replaces eq. residual_rot under correction B",
    statement: "The planar alignment of estimates leaves [E, (E - I) t' - rad(t'_hat - t')] beside T_tan', the axial one \
         [E, (E - I) t' - tan(t'_hat - t')] beside T_rad'.",
    verdict: Verdict::Exact,
    condition: Some("the translation is split in the target frame, t' = R^T t (L29)"),
    formula: "T_tan'^-1 [E, E t' - rad(t'_hat)] = [E, (E - I) t' - rad(t'_hat - t')],  E = R_hat^T R",
    derivation: "Q_pla = R_hat^T (R P + R t') - rad(t'_hat) = E P + E t' - rad(t'_hat); take t'_tan = t' - rad(t') off. Unlike \
         in eq. residual_rot the whole t' is turned by the rotation error, not only the part that was removed.",
    counter_example: None,
    correction: None,
    functions: &["deviation::alignment_residual", "deviation::alignment_products"],
    taped: &[],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    let pose = |w: [f64; 3], t: [f64; 3]| Se3::from_rotation_vector(&w.into(), t.into());
    let truth = pose([0.03, -0.05, 0.02], [0.06, 0.04, -0.08]);
    let (planar, _) = alignment_residual(&truth, &pose([0.032, -0.047, 0.021], [0.066, 0.037, -0.085]));
    for (k, expected) in [0.000284298533312, -0.000223880002433, 0.00517431067159].into_iter().enumerate() {
        trial.findings.documented("planar leftover, documented, m", planar.translation[k], expected, 1e-11);
    }
}

fn at(case: &Case, f: &mut Findings) {
    let (truth, guess) = (case.motion, estimate(case));
    let scale = 1.0 + truth.translation.norm();
    let distance = |a: &Se3, b: &Se3| ((a.rotation - b.rotation).amax() + (a.translation - b.translation).norm()) / scale;
    let (planar, axial) = alignment_residual(&truth, &guess);
    let (planar_product, axial_product) = alignment_products(&truth, &guess);
    f.residual("planar leftover - product of motions", distance(&planar, &planar_product), 1e-13);
    f.residual("axial leftover - product of motions", distance(&axial, &axial_product), 1e-13);
    points(case, &guess, [planar, axial], f);
}

/// The aligned point of an exact match is the leftover, then the part that was meant to stay.
fn points(case: &Case, guess: &Se3, [planar, axial]: [Se3; 2], f: &mut Findings) {
    let Some(exact) = case.exact_match() else {
        return f.residual("point in front of the camera", f64::NAN, 1.0);
    };
    let unrotated = unrotated_point(&case.camera, &guess.rotation, &exact);
    let (t, a) = (case.in_target(), guess.translation_in_from_frame());
    let scale = 1.0 + case.point().norm();
    let off =
        |found: Vector3<f64>, left: Se3, stays: Vector3<f64>| (found - left.transform(&case.point()) - stays).norm() / scale;
    f.residual(
        "planar point - T_tan' leftover P_t, relative",
        off(unrotated - radial_part(&a), planar, tangential_part(&t)),
        1e-12,
    );
    f.residual(
        "axial point - T_rad' leftover P_t, relative",
        off(unrotated - tangential_part(&a), axial, radial_part(&t)),
        1e-12,
    );
}

#[cfg(test)]
mod tests {
    crate::ledger::testing::tests_on_cases!(super::at);
}
