//! L26: a common optical axis and a common imaging plane.

use nalgebra::{Matrix3, Vector2, Vector3};

use crate::ledger::{Case, Claim, Findings, Trial, Verdict};
use crate::motion::{MotionParts, remaining_radial, remaining_tangential};
use crate::se3::Se3;

pub(super) static CLAIM: Claim = Claim {
    id: "L26",
    slug: "axis-plane-equivalence",
    place: "introduction of the section on the constraints",
    statement: "After removing rotation and tangential translation both cameras share the optical axis; after removing rotation \
         and radial translation they share the imaging plane.",
    verdict: Verdict::Exact,
    condition: None,
    formula: "left: T_rad = [I (0, 0, t_z)] or T_tan = [I (t_x, t_y, 0)]",
    derivation: "L23 leaves T_rad or T_tan. Under T_rad the axes are parallel and the source centre (0, 0, -t_z) lies on the \
         target's axis; under T_tan the planes are parallel and the source centre (-t_x, -t_y, 0) lies in the target's plane z \
         = 0, so all depths are equal in both.",
    counter_example: None,
    correction: None,
    functions: &["motion::remaining_radial", "motion::remaining_tangential"],
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
    let (axis, plane) = (remaining_radial(motion, &parts), remaining_tangential(motion, &parts));
    let turned = |left: &Se3| (left.rotation - Matrix3::identity()).amax();
    f.residual("rotation left beside the common axis", turned(&axis), 1e-13);
    f.residual("rotation left beside the common plane", turned(&plane), 1e-13);
    let (on_axis, in_plane) = (axis.inverse().translation, plane.inverse().translation);
    let t = motion.translation;
    f.residual("source centre - (0, 0, -t_z), by 1 + |t|", (on_axis + Vector3::new(0.0, 0.0, t.z)).norm() / scale, 1e-13);
    f.residual("source centre - (-t_x, -t_y, 0), by 1 + |t|", (in_plane + Vector3::new(t.x, t.y, 0.0)).norm() / scale, 1e-13);
    image(case, &axis, &plane, f);
}

/// What the two images show: a point keeps its radial line under the common axis, its depth in the common plane.
fn image(case: &Case, axis: &Se3, plane: &Se3, f: &mut Findings) {
    let (camera, point, d) = (&case.camera, case.point(), case.offset());
    let pixel = |left: &Se3| camera.project(&left.transform(&point)).unwrap_or(Vector2::repeat(f64::NAN));
    let across = (pixel(axis) - camera.principal_point()).perp(&d) / d.norm().max(1.0);
    f.residual("distance of the moved pixel from its radial line, px", across, 1e-10);
    f.residual("depth change under the common plane, relative", (plane.transform(&point).z - point.z) / point.z, 1e-13);
}

#[cfg(test)]
mod tests {
    crate::ledger::testing::tests_on_cases!(super::at);
}
