//! L13: the order in which translation and rotation can be removed.

use nalgebra::{Vector2, Vector3};

use crate::flow::rigid::{rigid_flow, rigid_flow_by_parts};
use crate::homography::{rotation_homography, transfer};
use crate::ledger::{Case, Claim, Findings, Trial, Verdict, forward};
use crate::motion::translation_gap;
use crate::removal::{printed_rotation_first, rotation_first, translation_first, without_translation};
use crate::{Se3, scenes, so3};

pub(super) static CLAIM: Claim = Claim {
    id: "L13",
    slug: "footnote-order",
    place: "footnote on the order",
    statement: "The translational part cannot be removed before the rotational part, because rigid motions do not commute.",
    verdict: Verdict::Fails,
    condition: None,
    formula: "P_s - t = R P_t;  R^T (P_s - t) = P_t = R^T P_s - R^T t;  f = (p_R - p) + [f o t - (p_R - p0) t_z] / (z_R + t_z)",
    derivation: "In T = T_rad T_tan T_rot the translation is the outermost factor, so on source points it comes off first, and \
                 exactly. That rotations and translations do not commute only decides which vector comes off: t before R is \
                 undone, R^T t after. What is true: taking off the translation needs depth, taking off the rotation does not.",
    counter_example: Some(
        "K of kitti640, omega = (0.03, -0.05, 0.02), t = (0.06, 0.04, -0.08), p = (451, 63), z = 12.5: translation first leaves \
         (431.567, 54.839), the pixel of the homography. Rotation first and then t, as in pplanar, gives (450.943, 62.882) and \
         misses p.",
    ),
    correction: Some("Either order works: t off before the rotation is undone, R^T t after."),
    functions: &[
        "removal::without_translation",
        "removal::translation_first",
        "removal::rotation_first",
        "removal::printed_rotation_first",
        "flow::rigid::rigid_flow_by_parts",
        "so3::commutator",
    ],
    taped: &[],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    let (camera, p) = (scenes::kitti640(), Vector2::new(451.0, 63.0));
    let motion = Se3::from_rotation_vector(&Vector3::new(0.03, -0.05, 0.02), Vector3::new(0.06, 0.04, -0.08));
    let source = motion.transform(&(camera.ray(p.x, p.y) * 12.5));
    let seen = |point: Vector3<f64>| camera.project(&point).unwrap_or(Vector2::repeat(f64::NAN));
    let [left, printed] = [seen(without_translation(&motion, &source)), seen(printed_rotation_first(&motion, &source))];
    let f = &mut trial.findings;
    for (k, [first, wrong]) in [[431.567088882, 450.943413021], [54.8393440356, 62.8822193515]].into_iter().enumerate() {
        f.documented("translation first, documented", left[k], first, 1e-11);
        f.documented("rotation first, then t as printed, documented", printed[k], wrong, 1e-11);
    }
    f.gap("rotation first, then t as printed - p, px", (printed - p).norm(), 0.117);
    let (x, y) = (Vector3::x(), Vector3::y());
    for (angle, expected) in [(0.001, 1.4142134445219246e-06), (0.01, 0.00014142017768574284), (0.1, 0.014130310354494803)] {
        let found = so3::commutator(&(x * angle), &(y * angle)).norm();
        f.documented("commutator of two axis rotations, documented", found, expected, 1e-8);
    }
    f.gap(
        "two rotations in either order, 0.01 rad about x and y: Frobenius norm",
        so3::commutator(&(x * 0.01), &(y * 0.01)).norm(),
        1.27e-4,
    );
}

fn at(case: &Case, f: &mut Findings) {
    let (motion, point) = (&case.motion, case.point());
    let (source, size) = (motion.transform(&point), point.norm());
    f.residual("R^T (P_s - t) - P_t, relative", (translation_first(motion, &source) - point).norm() / size, 1e-14);
    f.residual("R^T P_s - R^T t - P_t, relative", (rotation_first(motion, &source) - point).norm() / size, 1e-14);
    let miss = printed_rotation_first(motion, &source) - point;
    f.residual("R^T P_s - t - P_t misses by (R^T - I) t, relative", (miss - translation_gap(motion)).norm() / size, 1e-14);
    image(case, &source, f);
    depth(case, &source, f);
}

/// What is left without the translation is the flow of the rotation, and the flow is the sum of both.
fn image(case: &Case, source: &Vector3<f64>, f: &mut Findings) {
    let (camera, motion, p, z) = (&case.camera, &case.motion, case.pixel, case.depth);
    let nowhere = Vector2::repeat(f64::NAN);
    let turned = transfer(&rotation_homography(camera, &motion.rotation), &p).map_or(nowhere, |(pixel, _)| pixel);
    let left = camera.project(&without_translation(motion, source)).unwrap_or(nowhere);
    f.residual("pixel of P_s - t - pixel of the homography, px", (left - turned).norm(), 1e-10);
    let still = forward::rigid_flow::<f64>(camera, so3::log(&motion.rotation).into(), [0.0; 3], p.into(), z).0;
    f.residual("pixel of P_s - t - p - rotational flow written out, px", (left - p - Vector2::from(still)).norm(), 1e-10);
    let whole = rigid_flow(camera, motion, &p, z).map_or(nowhere, |(flow, _)| flow);
    let (rotational, translational) = rigid_flow_by_parts(camera, motion, &p, z).unwrap_or((nowhere, nowhere));
    f.residual(
        "flow - rotational - translational flow at the turned pixel, px",
        (whole - rotational - translational).norm(),
        1e-10,
    );
}

/// With a wrong source depth the rotation still comes off exactly, as a turn of the viewing ray; the translation does not.
fn depth(case: &Case, source: &Vector3<f64>, f: &mut Findings) {
    let wrong = source * case.extra(0, 1.1, 2.0);
    let ray = |point: Vector3<f64>| point.normalize();
    let back = |point: &Vector3<f64>| ray(case.motion.rotation.tr_mul(point));
    f.residual("direction after the rotation is undone, right - wrong depth, rad", (back(&wrong) - back(source)).norm(), 1e-14);
    let t = case.motion.translation;
    // Where t is hardly seen from the side, or is small, the miss is small too.
    if source.cross(&t).norm() > 0.01 * source.norm() * case.depth {
        let miss = (ray(without_translation(&case.motion, &wrong)) - ray(source - t)).norm();
        f.floor("translation taken off at a wrong depth: miss of the direction, rad", miss, 1e-5);
    }
}

#[cfg(test)]
mod tests {
    crate::ledger::testing::tests_on_cases!(super::at);
}
