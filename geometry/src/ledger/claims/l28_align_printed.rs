//! L28: the alignment of eq. `pplanar` as printed.

use nalgebra::Vector2;

use crate::alignment::{Convention, axial, planar, printed};
use crate::flow::{radial::radial_flow, tangential::tangential_flow};
use crate::ledger::{Case, Claim, Findings, Trial, Verdict, forward, taped};
use crate::losses::{AxialForm, LossOptions, PlanarForm};
use crate::motion::{radial_part, tangential_part};
use crate::scenes::{self, Reference};
use crate::so3;

pub(super) static CLAIM: Claim = Claim {
    id: "L28",
    slug: "align-printed",
    place: "eqs. pplanar, disflow",
    statement: "With Q_pla = R^-1 P_s - t_rad and Q_axi = R^-1 P_s - t_tan, f_pla is caused by t_tan and f_axi by t_rad alone.",
    verdict: Verdict::Fails,
    condition: None,
    formula: "f_pla = [f o (t_tan + delta_tan) - d delta_z] / (z + delta_z),  f_axi = [f o delta_tan - d (t_z + delta_z)] / (z \
         + t_z + delta_z),  delta = (R^T - I) t = -(omega x t) + O(omega^2)",
    derivation: "R^-1 P_s = P_t + R^T t, so Q_pla = P_t + t_tan + delta and Q_axi = P_t + t_rad + delta. Right only if R t = t: \
         no rotation, or one about t. Only delta_z disturbs the direction of f_pla. f_axi is the field of a pure translation \
         with focus p0 + f o delta_tan / (t_z + delta_z): L_axi depends on the rotation and the direction of t, on no depth. \
         The losses would be least at t_hat = R^T t, eq. p_s at t_hat = t.",
    counter_example: Some(
        "Perfect depth, pose and flow; circular L_pla, L_axi with sign, L_tan, L_rad, zero in the corrected form: drive_next \
         9.3e-7, 0.00691, 0.516, 0.00976; drive_prev 1.6e-6, 0.00692, 0.486, 0.0112; turn 1.4e-5, 0.0581, 8.31, 0.102; handheld \
         2.6e-4, 0.137, 0.265, 0.198; lateral 1.3e-6, 0.0579, 0.0625, 0.0949; generic 3.7e-5, 0.0548, 0.115, 0.0651.",
    ),
    correction: Some(
        "Split t' = R^T t instead of t (B, L29); or read T from source to target, R_hat p + rad/tan(t_hat) (E, L30); or compare \
         P_s - rad/tan(t) with the rotated target (C), or p_s with the moved target (C', both L31).",
    ),
    functions: &[
        "alignment::printed::planar_flow",
        "alignment::printed::axial_flow",
        "alignment::printed::defect",
        "alignment::printed::defect_first_order",
        "alignment::printed::focus_offset",
        "alignment::printed::planar_loss_first_order",
        "alignment::printed::axial_loss_first_order",
        "alignment::printed::forward_axial_loss_first_order",
        "alignment::printed::tangential_ratio_factors",
        "alignment::printed::radial_ratio_error_first_order",
    ],
    taped: &["taped::align", "losses::planar", "losses::axial", "losses::tangential", "losses::radial"],
    missing_way: None,
    check,
};

/// Losses of the six reference motions with the printed alignment: `L_pla` (circular), `L_axi` (with sign), `L_tan`, `L_rad`.
const PRINTED: [[f64; 4]; 6] = [
    [9.2625343928e-07, 0.00691432229325, 0.516002449805, 0.00976264105671],
    [1.58712888793e-06, 0.00691517220908, 0.48618265315, 0.0112467369974],
    [1.40353838384e-05, 0.0580573406461, 8.31125747816, 0.102174823862],
    [0.000258946369196, 0.136647301837, 0.265076311818, 0.197590443889],
    [1.33124128425e-06, 0.0578682385776, 0.0624844671719, 0.0949314608207],
    [3.74690672518e-05, 0.0548493708649, 0.115458357967, 0.0650629507859],
];

fn check(trial: &mut Trial) {
    trial.cases(at);
    for (reference, printed) in scenes::references().iter().zip(PRINTED) {
        table(reference, printed, &mut trial.findings);
        trial.count(reference.scene.pixels.len());
    }
    first_order(&mut trial.findings);
}

/// The printed alignment of an exact match against its closed form and against a second implementation.
fn at(case: &Case, f: &mut Findings) {
    let (camera, motion, t) = (&case.camera, &case.motion, case.motion.translation);
    let nowhere = Vector2::repeat(f64::NAN);
    let Some(exact) = case.exact_match() else {
        return f.residual("point in front of the camera", f64::NAN, 1.0);
    };
    let closed =
        [printed::planar_flow, printed::axial_flow].map(|flow| flow(camera, motion, &case.pixel, case.depth).unwrap_or(nowhere));
    let aligned = [planar(camera, &motion.rotation, &t, &exact), axial(camera, &motion.rotation, &t, &exact)];
    let w = so3::log(&motion.rotation).into();
    let (flow, source_depth) = forward::rigid_flow::<f64>(camera, w, t.into(), case.pixel.into(), case.depth);
    let source = (case.pixel + Vector2::from(flow)).into();
    let second = [radial_part(&t), tangential_part(&t)].map(|removed| {
        forward::aligned::<f64>(camera, [w, [0.0; 3]], removed.into(), [case.pixel.into(), source], source_depth).0
    });
    for k in 0..2 {
        let found = aligned[k].map_or(nowhere, |a| a.flow);
        f.residual("printed alignment - closed form, px", (found - closed[k]).norm(), 1e-9);
        f.residual("second implementation - closed form, px", (Vector2::from(second[k]) - closed[k]).norm(), 1e-9);
    }
    defects(case, f);
    without_rotation(case, f);
}

fn defects(case: &Case, f: &mut Findings) {
    let (motion, t) = (&case.motion, case.motion.translation);
    let (omega, size) = (so3::log(&motion.rotation), 1.0 + t.norm());
    let delta = printed::defect(motion);
    let second_order = 0.5 * omega.norm_squared() * t.norm();
    let excess = (delta - printed::defect_first_order(&omega, &t)).norm() - second_order;
    f.bound("(|delta + omega x t| - angle^2 |t| / 2) / (1 + |t|), but for rounding", excess / size, 1e-14);
    // A rotation about t leaves no defect.
    let about_t = so3::exp(&(t.try_normalize(0.0).unwrap_or_default() * omega.norm()));
    let along = crate::Se3 { rotation: about_t, translation: t };
    f.residual("defect of a rotation about t, by 1 + |t|", printed::defect(&along).norm() / size, 1e-14);
    if let Some(offset) = printed::focus_offset(&case.camera, motion) {
        let radial = case.in_target().z;
        let flow = printed::axial_flow(&case.camera, motion, &(case.camera.principal_point() + offset), case.depth);
        let share = radial.abs() * offset.norm().max(1.0) / (case.depth + radial);
        f.residual("axial flow at its focus, relative to its shares", flow.map_or(f64::NAN, |flow| flow.norm()) / share, 1e-10);
    }
}

/// Printed and corrected alignment are one without rotation.
fn without_rotation(case: &Case, f: &mut Findings) {
    let straight = case.without_rotation();
    let (camera, t) = (&case.camera, straight.motion.translation);
    let nowhere = Vector2::repeat(f64::NAN);
    let flow = |closed: fn(&_, &_, &_, f64) -> Option<Vector2<f64>>| {
        closed(camera, &straight.motion, &case.pixel, case.depth).unwrap_or(nowhere)
    };
    let tangential = tangential_flow(camera, &t, case.depth);
    let radial = radial_flow(camera, t.z, &case.pixel, case.depth).unwrap_or(nowhere);
    f.residual("printed f_pla for R = I - f o t / z, px", (flow(printed::planar_flow) - tangential).norm(), 1e-10);
    f.residual("printed f_axi for R = I - radial flow, px", (flow(printed::axial_flow) - radial).norm(), 1e-10);
}

/// One row of the table: plain and taped losses, printed and corrected.
fn table(reference: &Reference, expected: [f64; 4], f: &mut Findings) {
    let Reference { name, scene, motion } = reference;
    let plain = |convention| scene.aligned(motion, convention).losses(&scene.depths);
    let options = |convention| LossOptions {
        convention,
        planar: PlanarForm::Circular,
        axial: AxialForm::PoseSign,
        tau_flow: 0.0,
        q_min: 0.0,
        ..LossOptions::literal()
    };
    let on_tape = |convention| taped::scene_losses(scene, motion, &options(convention));
    let (printed, tape) = (plain(Convention::AsPrinted), on_tape(Convention::AsPrinted));
    for k in 0..4 {
        let term = ["L_pla", "L_axi", "L_tan", "L_rad"][k];
        // The circular form is 2 (1 - |mean|): its rounding is that of 1, not of its value.
        let precision = if k == 0 { 5e-8 } else { 1e-11 };
        f.documented("losses of the printed alignment, documented", printed[k], expected[k], precision);
        let scale = expected[k].max(1e-3);
        f.equal("taped losses of the printed alignment - plain ones, relative", tape[k], printed[k], scale, 1e-9);
        f.gap(&format!("{term} of the printed alignment, {name}"), printed[k], 0.9 * expected[k]);
    }
    for k in 0..4 {
        f.residual("losses of the corrected alignment", plain(Convention::Consistent)[k], 1e-9);
        f.residual("taped losses of the corrected alignment", on_tape(Convention::Consistent)[k], 1e-9);
    }
    literal(reference, f);
}

/// The printed losses with the corrected alignment: zero for both sources of a snippet but for the sign of eq. `la`, which costs
/// pi wherever `t'_z > 0` (L41).
fn literal(reference: &Reference, f: &mut Findings) {
    let Reference { scene, motion, .. } = reference;
    let options = LossOptions { convention: Convention::Consistent, ..LossOptions::literal() };
    let losses = taped::scene_losses(scene, motion, &options);
    let sign = if motion.translation_in_from_frame().z > 0.0 { std::f64::consts::PI } else { 0.0 };
    for k in [0, 2, 3] {
        f.residual("taped printed L_pla, L_tan, L_rad of the corrected alignment", losses[k], 1e-9);
    }
    // An arccos near cosine 1 keeps half of the digits.
    f.residual("taped printed L_axi of the corrected alignment - (0 or pi), rad", losses[1] - sign, 3e-8);
}

/// First orders of the effects, at small rotations.
fn first_order(f: &mut Findings) {
    let scene = scenes::road();
    let (camera, d) = (&scene.camera, scene.offsets());
    for (omega, expected) in [([0.0, 1.0, 0.0], 0.0284), ([1.0, 0.0, 0.0], 0.0442)] {
        let per_degree = nalgebra::Vector3::from(omega) * 1f64.to_radians();
        let found = printed::forward_axial_loss_first_order(camera, &per_degree, &d);
        f.documented_within("L_axi per degree of yaw or pitch, documented, rad", found, expected, 5e-5);
    }
    for size in [1e-3, 1e-4] {
        let omega = [0.3 * size, size, -0.2 * size];
        let motion = scenes::motion(omega, [0.02, -0.01, -0.8]);
        let loss = printed::axial_loss(camera, &motion, &d);
        let by_focus = printed::axial_loss_first_order(camera, &motion, &d);
        f.bound("|L_axi - first order|, by angle^2", (loss - by_focus).abs() / (size * size), 0.2);
        let forward = scenes::motion(omega, [0.0, 0.0, -0.8]);
        let loss = printed::axial_loss(camera, &forward, &d);
        let by_angle = printed::forward_axial_loss_first_order(camera, &omega.into(), &d);
        f.bound("|L_axi of forward motion - first order|, by angle^2", (loss - by_angle).abs() / (size * size), 0.4);
        let loss = printed::planar_loss(camera, &motion, &d);
        let planar = printed::planar_loss_first_order(camera, &motion, &d);
        f.bound("|L_pla - leading order|, by angle^3", (loss - planar).abs() / size.powi(3), 0.01);
        ratios(&scene, &motion, size, f);
    }
}

/// `rho_x t_x / z` against `t_x / t'_x`, and the radial ratio's error, both to first order in the angle.
fn ratios(scene: &scenes::Scene, motion: &crate::Se3, size: f64, f: &mut Findings) {
    let (camera, t) = (&scene.camera, motion.translation);
    let factors = printed::tangential_ratio_factors(motion);
    for (p, &z) in scene.pixels.iter().zip(&scene.depths) {
        let nowhere = Vector2::repeat(f64::NAN);
        let plane = printed::planar_flow(camera, motion, p, z).unwrap_or(nowhere);
        let rho = crate::ratios::tangential_ratios(camera, &plane);
        // What is left is delta_z against the flow f t'_x: of the order d delta_z / (f t'_x).
        f.bound("|rho_x t_x / z - t_x / t'_x|, by the angle", (rho.x * t.x / z - factors.x).abs() / size, 1.2);
        let axis = printed::axial_flow(camera, motion, p, z).unwrap_or(nowhere);
        let d = p - camera.principal_point();
        let error = crate::ratios::radial_ratio(&axis, &d) * t.z / z - 1.0;
        let closed = printed::radial_ratio_error_first_order(camera, motion, &d, z).unwrap_or(f64::NAN);
        f.bound("|rho_z t_z / z - 1 - first order|, by angle^2", (error - closed).abs() / (size * size), 1500.0);
    }
}

#[cfg(test)]
mod tests {
    crate::ledger::testing::tests_on_cases!(super::at);
}
