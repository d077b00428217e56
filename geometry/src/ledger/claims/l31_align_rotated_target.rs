//! L31: alignment against the rotated or the moved target (corrections C and C').

use nalgebra::Vector2;

use super::l24_residual_rows::estimate;
use crate::alignment::corrections::{moved_target, rotated_target};
use crate::deviation::{residual_rows, rotated_target_residual};
use crate::flow::tangential::focal_scaled;
use crate::ledger::{Case, Claim, Findings, Trial, Verdict, forward};
use crate::loss_forms::{axial, planar, radial, tangential};
use crate::motion::{radial_part, tangential_part};
use crate::scenes::{self, Reference};
use crate::so3;

pub(super) static CLAIM: Claim = Claim {
    id: "L31",
    slug: "align-rotated-target",
    place: "corrections C and C' of eq. pplanar",
    statement: "C: P_s - part(t), without R^-1, compared with the rotated target pixel p_R at depth z_R; C': p_s compared with \
         pi(R P_t + part(t)). Both keep [R t] and eq. transformation.",
    verdict: Verdict::Exact,
    condition: Some("p_R, z_R (C) or q = pi(R P_t + tan(t)) and its depth (C') stand for p_t and z_t in the losses"),
    formula: "C: f_pla = f o t_tan / z_R, f_axi = -t_z / (z_R + t_z) (p_R - p0);  C': f_pla = f o t_tan / (z_R + t_z), \
         f_axi = -t_z / (z_R + t_z) (q - p0)",
    derivation: "P_s = R P_t + t. C: P_s - rad(t) = R P_t + tan(t) and P_s - tan(t) = R P_t + rad(t), the flows of L14 and L15 \
         from the point R P_t. C': R P_t + rad(t) and R P_t + tan(t) lack one part of P_s each. With errors C leaves [dR^-1, \
         -dt_rad] beside T_tan, without a cross term; C' leaves eq. residual_rot.",
    counter_example: None,
    correction: None,
    functions: &[
        "alignment::corrections::rotated_target",
        "alignment::corrections::moved_target",
        "deviation::rotated_target_residual",
    ],
    taped: &[],
    missing_way: Some(
        "The claim states no derivative, and training aligns by correction B: C and C' have no operation on the tape.",
    ),
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    for reference in scenes::references() {
        losses(&reference, &mut trial.findings);
        trial.count(reference.scene.pixels.len());
    }
}

fn at(case: &Case, f: &mut Findings) {
    let (camera, motion, t) = (&case.camera, &case.motion, case.motion.translation);
    let both = case.exact_match().and_then(|exact| {
        Some((rotated_target(camera, motion, &exact, case.depth)?, moved_target(camera, motion, &exact, case.depth)?))
    });
    // A part of the translation alone can bring a point closer to the camera's plane than the whole does.
    let Some((c, moved)) = both.filter(|(c, moved)| moved.axial.depth.min(c.planar.depth + t.z) > 0.1 * case.depth) else {
        return;
    };
    let (source_depth, p0) = (c.planar.depth + t.z, camera.principal_point());
    let flows = focal_scaled(camera, &t);
    f.residual("C: f_pla z_R - f o t_tan, px m", (c.planar.flow * c.planar.depth - flows).norm(), 1e-9);
    let radial = (c.axial.pixel - p0) * t.z;
    f.residual("C: f_axi (z_R + t_z) + t_z (p_R - p0), px m", (c.axial.flow * source_depth + radial).norm(), 1e-9);
    f.residual("C': f_pla (z_R + t_z) - f o t_tan, px m", (moved.planar.flow * moved.planar.depth - flows).norm(), 1e-9);
    let radial = (moved.axial.pixel - p0) * t.z;
    f.residual("C': f_axi (z_R + t_z) + t_z (q - p0), px m", (moved.axial.flow * source_depth + radial).norm(), 1e-9);
    second_implementation(case, [c.planar.flow, c.axial.flow, moved.planar.flow, moved.axial.flow], f);
    deviations(case, f);
}

/// The four flows once more, from points turned by the power series.
fn second_implementation(case: &Case, flows: [Vector2<f64>; 4], f: &mut Findings) {
    let (w, t) = (so3::log(&case.motion.rotation).into(), case.motion.translation);
    let turned = forward::rotated::<f64>(w, case.point().into());
    let source = forward::sum(turned, t.into());
    let parts = [radial_part(&t).into(), tangential_part(&t).into()];
    let seen = |x| Vector2::from(forward::projected::<f64>(&case.camera, x));
    let [c_planar, c_axial] = parts.map(|part| seen(forward::difference(source, part)) - seen(turned));
    let [moved_planar, moved_axial] = parts.map(|part| seen(source) - seen(forward::sum(turned, part)));
    for (flow, second) in flows.into_iter().zip([c_planar, c_axial, moved_planar, moved_axial]) {
        f.residual("flows of C and C' - second implementation, px", (flow - second).norm(), 1e-9);
    }
}

/// What estimates leave: the source point from the point that the target was taken to.
fn deviations(case: &Case, f: &mut Findings) {
    let (truth, guess, point) = (&case.motion, estimate(case), case.point());
    let (source, turned, t) = (truth.transform(&point), guess.rotation * point, truth.translation);
    let (c, rows) = (rotated_target_residual(truth, &guess), residual_rows(truth, &guess));
    let scale = 1.0 + point.norm();
    let planar = c.tangential.transform(&turned) + tangential_part(&t) - (source - radial_part(&guess.translation));
    f.residual("C: planar point - T_tan [dR^-1, -dt_rad] R_hat P_t, relative", planar.norm() / scale, 1e-12);
    let axial = c.radial.transform(&turned) + radial_part(&t) - (source - tangential_part(&guess.translation));
    f.residual("C: axial point - T_rad [dR^-1, -dt_tan] R_hat P_t, relative", axial.norm() / scale, 1e-12);
    let moved = rows.tangential.transform(&(turned + radial_part(&guess.translation))) + tangential_part(&t) - source;
    f.residual("C': source point - T_tan residual_rot (R_hat P_t + rad), relative", moved.norm() / scale, 1e-12);
}

/// All four losses of the reference motions vanish under C, the direction losses under C'.
fn losses(reference: &Reference, f: &mut Findings) {
    let Reference { scene, motion, .. } = reference;
    let (camera, t) = (&scene.camera, motion.translation);
    let (mut c, mut moved) = (Vec::new(), Vec::new());
    for (m, &z) in scene.matches(motion).iter().zip(&scene.depths) {
        c.extend(rotated_target(camera, motion, m, z));
        moved.extend(moved_target(camera, motion, m, z));
    }
    let all = scene.pixels.len();
    f.residual("pixels behind a camera", (2 * all - c.len() - moved.len()) as f64, 0.0);
    let depths: Vec<_> = c.iter().map(|x| x.planar.depth).collect();
    let d = |x: &Vector2<f64>| x - camera.principal_point();
    let (planar_c, axial_c): (Vec<_>, Vec<_>) = c.iter().map(|x| (x.planar.flow, x.axial.flow)).unzip();
    let d_c: Vec<_> = c.iter().map(|x| d(&x.axial.pixel)).collect();
    let (planar_m, axial_m): (Vec<_>, Vec<_>) = moved.iter().map(|x| (x.planar.flow, x.axial.flow)).unzip();
    let d_m: Vec<_> = moved.iter().map(|x| d(&x.axial.pixel)).collect();
    let under_c = [
        planar::circular(&planar_c),
        axial::pose_sign(&axial_c, &d_c, t.z),
        tangential::printed(camera, &planar_c, &depths, &t),
        radial::printed(&axial_c, &d_c, &depths, &t),
    ];
    for loss in under_c {
        f.residual("C: losses of the reference motions", loss, 1e-9);
    }
    for loss in [planar::circular(&planar_m), axial::pose_sign(&axial_m, &d_m, t.z)] {
        f.residual("C': direction losses of the reference motions", loss, 1e-9);
    }
}

#[cfg(test)]
mod tests {
    crate::ledger::testing::tests_on_cases!(super::at);
}
