//! L06: split of a motion into rotation, tangential and radial translation.

use dimode_autodiff::Tape;
use nalgebra::{Matrix4, Vector3};

use crate::ledger::{Case, Claim, Findings, Trial, Verdict, taped};
use crate::motion::{MotionParts, radial_part, tangential_part, translation_gap, translation_gap_first_order};
use crate::taped::{so3_exp, translation_in_target_frame};
use crate::{Se3, so3};

pub(super) static CLAIM: Claim = Claim {
    id: "L06",
    slug: "decomposition",
    place: "eq. transformation",
    statement: "T = T_rad T_tan T_rot: a motion is a rotation, then a tangential, then a radial translation.",
    verdict: Verdict::Exact,
    condition: None,
    formula: "[R t] = [I rad(t)] [I tan(t)] [R 0] = [R 0] [I rad(t')] [I tan(t')],  t' = R^T t",
    derivation: "Multiply out: translations add, and rad(t) + tan(t) = t. T_rad and T_tan commute, T_rot commutes with neither: \
                 behind the rotation the translation is R^T t. So the split is not unique; the parts of both splits differ by \
                 delta = t' - t = (R^T - I) t, to first order -(omega x t), and the remainder is at most |omega|^2 |t| / 2.",
    counter_example: None,
    correction: None,
    functions: &[
        "motion::MotionParts::in_source_frame",
        "motion::MotionParts::in_target_frame",
        "motion::translation_gap",
        "motion::translation_gap_first_order",
    ],
    taped: &["taped::translation_in_target_frame", "taped::so3_exp"],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    let (omega, t) = (Vector3::new(0.03, -0.05, 0.02), Vector3::new(0.06, 0.04, -0.08));
    let motion = Se3::from_rotation_vector(&omega, t);
    let target = MotionParts::in_target_frame(&motion);
    let in_target = target.tangential.translation + target.radial.translation;
    let delta = translation_gap(&motion);
    let f = &mut trial.findings;
    let documented =
        [[0.056661070926, -0.00333892907402], [0.0363712893823, -0.00362871061774], [-0.0840633829333, -0.00406338293331]];
    for (k, [expected, gap]) in documented.into_iter().enumerate() {
        f.documented("t', documented", in_target[k], expected, 1e-11);
        f.documented("t' - t, documented", delta[k], gap, 1e-11);
    }
    let source = MotionParts::in_source_frame(&motion);
    f.gap("tangential part of one split - that of the other, m", (source.tangential.translation - in_target).xy().norm(), 0.0044);
    f.gap("parts of the one split in the other order - T, m", (source.rotation_last().translation - t).norm(), 0.0057);
}

/// The motion as a matrix of four rows.
fn matrix(motion: &Se3) -> Matrix4<f64> {
    let mut out = motion.rotation.to_homogeneous();
    out.fixed_view_mut::<3, 1>(0, 3).copy_from(&motion.translation);
    out
}

fn at(case: &Case, f: &mut Findings) {
    let (motion, t) = (&case.motion, case.motion.translation);
    let scale = 1.0 + t.norm();
    let whole = matrix(motion);
    let source = MotionParts::in_source_frame(motion);
    let [rotation, tangential, radial] = [source.rotation, source.tangential, source.radial].map(|part| matrix(&part));
    let mut equal = |what: &str, a: Matrix4<f64>, b: Matrix4<f64>| f.residual(what, (a - b).abs().max() / scale, 1e-13);
    equal("T_rad T_tan T_rot - T as matrices, relative", radial * tangential * rotation, whole);
    equal("T_rad T_tan T_rot - T as motions, relative", matrix(&source.rotation_first()), whole);
    equal("T_rad T_tan - T_tan T_rad, relative", radial * tangential, tangential * radial);
    let target = MotionParts::in_target_frame(motion);
    let [rotation, tangential, radial] = [target.rotation, target.tangential, target.radial].map(|part| matrix(&part));
    equal("T_rot T_rad' T_tan' - T as matrices, relative", rotation * radial * tangential, whole);
    equal("T_rot T_rad' T_tan' - T as motions, relative", matrix(&target.rotation_last()), whole);
    let pure = source.radial.translation - radial_part(&t) + source.tangential.translation - tangential_part(&t);
    f.residual("parts - (0, 0, t_z) and (t_x, t_y, 0), relative", pure.norm() / scale, 1e-15);
    second_split(case, &source, &target, f);
}

/// The parts of both splits differ by `delta`, which is `-(omega x t)` to first order.
fn second_split(case: &Case, source: &MotionParts, target: &MotionParts, f: &mut Findings) {
    let (omega, t) = (so3::log(&case.motion.rotation), case.motion.translation);
    let delta = translation_gap(&case.motion);
    let sum = |parts: &MotionParts| parts.tangential.translation + parts.radial.translation;
    f.residual(
        "parts of the splits differ by delta, relative to z",
        (sum(target) - sum(source) - delta).norm() / case.depth,
        1e-14,
    );
    let remainder = (delta - translation_gap_first_order(&omega, &t)).norm();
    // Lengths up to 0.3 z: the second term is their rounding.
    let bound = 0.5 * omega.norm_squared() * t.norm() + 1e-15 * case.depth;
    f.bound("|delta + omega x t| / (|omega|^2 |t| / 2 + rounding)", remainder / bound, 1.0);
    let tape = Tape::new();
    let rotation = so3_exp(tape.constant(taped::column(omega.as_slice())));
    let in_target = translation_in_target_frame(rotation, tape.constant(taped::column(t.as_slice()))).value();
    let taped_gap = Vector3::from_fn(|k, _| in_target.at(0, k, 0, 0)) - t;
    f.residual("delta - delta on the tape, relative to z", (delta - taped_gap).norm() / case.depth, 1e-14);
}

#[cfg(test)]
mod tests {
    crate::ledger::testing::tests_on_cases!(super::at);
}
