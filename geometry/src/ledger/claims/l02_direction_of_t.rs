//! L02: from which frame to which the transformation leads.

use dimode_autodiff::Tape;
use nalgebra::{Matrix3, Vector2, Vector3};

use crate::flow::rigid::rigid_flow;
use crate::ledger::{Case, Claim, Findings, Trial, Verdict, forward};
use crate::motion::{radial_part, tangential_part, translation_gap};
use crate::taped::Pose;
use crate::taped::pose::pose_tensors;
use crate::{Se3, scenes, so3};

pub(super) static CLAIM: Claim = Claim {
    id: "L02",
    slug: "direction-of-T",
    place: "text around p_s; eq. transformation",
    statement: "One transformation T leads from the source view to the target view and carries target points to the source \
         camera.",
    verdict: Verdict::Fails,
    condition: None,
    formula: "P_s = R P_t + t;  its inverse is P_t = R^T P_s - R^T t",
    derivation: "Both readings are legitimate, and they are inverse to each other. eq. p_s and the flows of the components \
                 project R P_t + t: target to source. 'Rotate the source camera by R, then add a part of t' moves source \
                 points: source to target. With A = R^T, a = -t' = -R^T t it gives A P_s + rad(a) = P_t + tan(t'), as it \
                 should.",
    counter_example: Some(
        "R = exp(0.03, -0.05, 0.02), t = (0.06, 0.04, -0.08): the inverse has the translation (-0.056661, -0.036371, 0.084063), \
         not -t. With K of kitti640, p = (451, 63), z = 12.5 the flow of the inverse differs by 37 px.",
    ),
    correction: Some(
        "T of eq. p_s leads from target to source; where source points are moved, its inverse, of rotation R^T and translation \
         -R^T t.",
    ),
    functions: &["se3::Se3::transform", "se3::Se3::inverse", "se3::Se3::translation_in_from_frame", "flow::rigid::rigid_flow"],
    taped: &["taped::pose::inverse"],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    let motion = Se3::from_rotation_vector(&Vector3::new(0.03, -0.05, 0.02), Vector3::new(0.06, 0.04, -0.08));
    let inverse = motion.inverse();
    let f = &mut trial.findings;
    for (k, expected) in [-0.056661070926, -0.0363712893823, 0.0840633829333].into_iter().enumerate() {
        f.documented("translation of the inverse, documented", inverse.translation[k], expected, 1e-11);
    }
    f.gap("translation of the inverse + t, m", (inverse.translation + motion.translation).norm(), 0.0057);
    let (camera, p) = (scenes::kitti640(), Vector2::new(451.0, 63.0));
    let flow = |motion: &Se3| rigid_flow(&camera, motion, &p, 12.5).map_or(Vector2::repeat(f64::NAN), |(flow, _)| flow);
    f.gap("flow of the inverse - flow, px", (flow(&inverse) - flow(&motion)).norm(), 33.0);
    let point = camera.ray(p.x, p.y) * 12.5;
    let moved = motion.rotation * motion.transform(&point) + radial_part(&motion.translation);
    f.gap("source point moved by T of eq. p_s, without t_tan - (P_t + t_tan), m", miss(&moved, &point, &motion.translation), 1.2);
}

/// Distance from where a point should be when only the tangential part of `t` is left.
fn miss(moved: &Vector3<f64>, point: &Vector3<f64>, t: &Vector3<f64>) -> f64 {
    (moved - (point + tangential_part(t))).norm()
}

fn at(case: &Case, f: &mut Findings) {
    let (motion, point) = (&case.motion, case.point());
    let (inverse, size) = (motion.inverse(), point.norm());
    let there_and_back = inverse * *motion;
    f.residual("T^-1 T - I, rotation", (there_and_back.rotation - Matrix3::identity()).abs().max(), 1e-14);
    f.residual("T^-1 T - I, translation relative to the point", there_and_back.translation.norm() / size, 1e-14);
    let (rotation, translation) = pose_tensors::<f64>(&[*motion]);
    let tape = Tape::new();
    let taped = Pose { rotation: tape.constant(rotation), translation: tape.constant(translation) }.inverse().to_se3()[0];
    f.residual("inverse on the tape, rotation", (taped.rotation - inverse.rotation).amax(), 1e-14);
    f.residual(
        "inverse on the tape, translation relative to the point",
        (taped.translation - inverse.translation).norm() / size,
        1e-14,
    );
    let source = motion.transform(&point);
    let turned = forward::rotated::<f64>(so3::log(&motion.rotation).into(), point.into());
    let expected = Vector3::from(turned) + motion.translation;
    f.residual("T P_t - (R P_t + t), relative", (source - expected).norm() / size, 1e-14);
    f.residual("T^-1 P_s - P_t, relative", (inverse.transform(&source) - point).norm() / size, 1e-14);
    let gap = inverse.translation + motion.translation + translation_gap(motion);
    f.residual("translation of the inverse + t + (R^T - I) t, relative to the point", gap.norm() / size, 1e-14);
    flow_needs_target_to_source(case, &source, f);
    let moved = inverse.rotation * source + radial_part(&inverse.translation);
    f.residual("R^T P_s + rad(-t') - (P_t + tan(t')), relative", miss(&moved, &point, &case.in_target()) / size, 1e-14);
}

/// Eq. p_s with `T` gives the pixel of the source point.
fn flow_needs_target_to_source(case: &Case, source: &Vector3<f64>, f: &mut Findings) {
    let flow =
        rigid_flow(&case.camera, &case.motion, &case.pixel, case.depth).map_or(Vector2::repeat(f64::NAN), |(flow, _)| flow);
    let seen = case.camera.project(source).unwrap_or(Vector2::repeat(f64::NAN));
    f.residual("p + f - projection of P_s, px", (case.pixel + flow - seen).norm(), 1e-10);
    let there = Vector2::from(forward::projected::<f64>(&case.camera, (*source).into()));
    f.residual("p + f - projection of P_s written out, px", (case.pixel + flow - there).norm(), 1e-10);
}

#[cfg(test)]
mod tests {
    crate::ledger::testing::tests_on_cases!(super::at);
}
