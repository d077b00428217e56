//! L23: what is left of a motion after some of its parts were undone.

use nalgebra::Matrix3;

use crate::ledger::{Case, Claim, Findings, Trial, Verdict, forward};
use crate::motion::{MotionParts, remaining_radial, remaining_tangential};
use crate::se3::Se3;
use crate::so3;

pub(super) static CLAIM: Claim = Claim {
    id: "L23",
    slug: "ideal-decomposition",
    place: "fig. idealtransformation",
    statement: "Undoing rotation and tangential translation leaves T_rad, undoing rotation and radial translation leaves T_tan.",
    verdict: Verdict::Exact,
    condition: None,
    formula: "T T_rot^-1 = [I t],  T_rad = T T_rot^-1 T_tan^-1,  T_tan = T T_rot^-1 T_rad^-1",
    derivation: "T = T_rad T_tan T_rot, so T T_rot^-1 = T_rad T_tan = [I t]; T_tan^-1 on the right leaves T_rad. For the other \
         order T_rad T_tan = T_tan T_rad is needed: translations commute.",
    counter_example: None,
    correction: None,
    functions: &["motion::MotionParts::in_source_frame", "motion::remaining_radial", "motion::remaining_tangential"],
    taped: &[],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
}

fn at(case: &Case, f: &mut Findings) {
    let (motion, parts) = (&case.motion, MotionParts::in_source_frame(&case.motion));
    let scale = 1.0 + motion.translation.norm();
    let distance = |a: &Se3, b: &Se3| ((a.rotation - b.rotation).amax() + (a.translation - b.translation).norm()) / scale;
    let translation_only = Se3 { rotation: Matrix3::identity(), translation: motion.translation };
    f.residual("T T_rot^-1 - [I t]", distance(&(*motion * parts.rotation.inverse()), &translation_only), 1e-13);
    f.residual("T T_rot^-1 T_tan^-1 - T_rad", distance(&remaining_radial(motion, &parts), &parts.radial), 1e-13);
    f.residual("T T_rot^-1 T_rad^-1 - T_tan", distance(&remaining_tangential(motion, &parts), &parts.tangential), 1e-13);
    // The same on a point, without matrices: turned back, then moved by one part, it comes out moved by the other only.
    let (w, t, x) = (so3::log(&motion.rotation), motion.translation, case.point());
    let undone = |part: [f64; 3]| {
        let turned_back = forward::rotated_back::<f64>(w.into(), forward::difference(x.into(), part));
        forward::sum(forward::rotated(w.into(), turned_back), t.into())
    };
    let (radial, tangential) = (undone([t.x, t.y, 0.0]), undone([0.0, 0.0, t.z]));
    let left = |found: [f64; 3], moved: Se3| (nalgebra::Vector3::from(found) - moved.transform(&x)).norm() / (1.0 + x.norm());
    f.residual("point after undoing rotation and t_tan - point moved by t_rad, relative", left(radial, parts.radial), 1e-13);
    f.residual(
        "point after undoing rotation and t_rad - point moved by t_tan, relative",
        left(tangential, parts.tangential),
        1e-13,
    );
}

#[cfg(test)]
mod tests {
    crate::ledger::testing::tests_on_cases!(super::at);
}
