//! L21: where the depth gets small gradients.

use nalgebra::{Vector2, Vector3};

use crate::alignment::Convention;
use crate::flow::gradients::{depth_gradient_about_focus, depth_gradient_at_principal_point, translational_gradients};
use crate::flow::translational::focus_of_expansion;
use crate::ledger::flow_derivatives::{Input, ways};
use crate::ledger::{Case, Claim, Findings, Trial, Verdict};
use crate::scenes;

pub(super) static CLAIM: Claim = Claim {
    id: "L21",
    slug: "grad-z-claim",
    place: "text after eq. grad_tz",
    statement: "Depth inherently gets smaller gradients near the principal point.",
    verdict: Verdict::Conditional,
    condition: Some("t_tan = 0; in general the gradient is smallest at the focus of expansion e = p0 + f o t_tan / t_z"),
    formula: "|df/dz| = |t_z| |p - e| / (z + t_z)^2;  at p0 |f o t_tan| / (z + t_z)^2",
    derivation: "df/dz = -[f o t - d t_z] / (z + t_z)^2 and f o t - d t_z = -t_z (p - e). Zero at e, growing with the distance \
         from e; e = p0 only for t_tan = 0. For t_z = 0 there is no focus and the gradient is the same everywhere.",
    counter_example: Some(
        "kitti640, z = 12.5, t = (0.3, 0, -0.8): 0.8135 px/m at p0, 0 at 139.2 px beside it. Hand-held motion of the room: \
         e lies 361 px from p0, outside the image. Measured on KITTI odometry 00-10 (45808 pairs): |e - p0| has median 8.48, \
         90 % 23, 99 % 80.4 px, so for driving the statement is a fair approximation.",
    ),
    correction: Some("Smaller gradients near the focus of expansion."),
    functions: &[
        "flow::gradients::depth_gradient_about_focus",
        "flow::gradients::depth_gradient_at_principal_point",
        "flow::translational::focus_of_expansion",
    ],
    taped: &["taped::rigid_flow", "taped::so3_exp"],
    missing_way: None,
    check,
};

/// Lengths of `df/dz`, px/m, at p0 - (r, 0) with r = 0, 100 and 300 px, before kitti640 at 12.5 m.
const DOCUMENTED: [([f64; 3], [f64; 3]); 3] = [
    ([0.0, 0.0, -0.8], [0.0, 0.584410840821, 1.75323252246]),
    ([0.3, 0.0, -0.8], [0.813499890423, 0.229089049602, 0.93973263204]),
    ([0.3, 0.0, 0.05], [0.707036396248, 0.738781924096, 0.802272979794]),
];

fn check(trial: &mut Trial) {
    trial.cases(at);
    let (camera, f) = (scenes::kitti640(), &mut trial.findings);
    for (t, lengths) in DOCUMENTED {
        for (r, expected) in [0.0, 100.0, 300.0].into_iter().zip(lengths) {
            let p = camera.principal_point() - Vector2::new(r, 0.0);
            let length = depth_gradient_about_focus(&camera, &t.into(), &p, 12.5).unwrap_or(f64::NAN);
            f.documented("|df/dz| beside p0, documented", length, expected, 1e-10);
        }
    }
    let at_p0 = translational_gradients(&camera, &Vector3::new(0.3, 0.0, -0.8), &camera.principal_point(), 12.5);
    f.gap("|df/dz| at p0 with t_x = 0.3, px/m", at_p0.map_or(f64::NAN, |g| g.z.norm()), 0.73);
    let hand = scenes::handheld();
    let t = Convention::Consistent.translation(&hand.motion);
    let focus = focus_of_expansion(&hand.scene.camera, &t).unwrap_or(Vector2::repeat(f64::NAN));
    f.gap("focus of the hand-held motion - p0, px", (focus - hand.scene.camera.principal_point()).norm(), 325.0);
}

fn at(case: &Case, f: &mut Findings) {
    let case = case.without_rotation();
    let (camera, t, z) = (&case.camera, case.motion.translation, case.depth);
    let gradient = |p: &Vector2<f64>| translational_gradients(camera, &t, p, z).map_or(Vector2::repeat(f64::NAN), |g| g.z);
    // A gradient is the difference of a tangential and a radial share; rounding is measured against their sum.
    let share =
        |d: &Vector2<f64>| (Vector2::new(camera.fu * t.x, camera.fv * t.y).norm() + d.norm() * t.z.abs()) / (z + t.z).powi(2);
    let p0 = camera.principal_point();
    let unit = camera.fu.max(camera.fv) / (z + t.z);
    let at_p0 = depth_gradient_at_principal_point(camera, &t, z).unwrap_or(f64::NAN);
    f.equal("|df/dz| at p0, relative to max(f) / z_s", gradient(&p0).norm(), at_p0, unit, 1e-12);
    let Some(focus) = focus_of_expansion(camera, &t) else {
        let moved = gradient(&case.pixel) - gradient(&p0);
        return f.residual("df/dz at p - df/dz at p0 for t_z = 0, px/m", moved.norm(), 1e-12);
    };
    f.equal(
        "df/dz at the focus, relative to its shares",
        gradient(&focus).norm(),
        0.0,
        share(&(focus - p0)).max(f64::MIN_POSITIVE),
        1e-12,
    );
    let closed = depth_gradient_about_focus(camera, &t, &case.pixel, z).unwrap_or(f64::NAN);
    let ways = ways(&case);
    let [forward, tape, central] = [&ways.forward, &ways.tape, &ways.central].map(|way| [way[Input::Depth as usize].norm()]);
    f.derivative("|df/dz| = |t_z| |p - e| / z_s^2", &[closed], Some(&forward), Some(&tape), Some(&central), ways.scale);
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::ledger::testing::{case, holds, limit};

    proptest! {
        #[test]
        fn holds_everywhere(case in case()) {
            holds(|f| at(&case, f))?;
        }

        #[test]
        fn holds_at_the_limits(case in limit()) {
            holds(|f| at(&case, f))?;
        }

        #[test]
        fn the_gradient_grows_with_the_distance_from_the_focus(
            case in case(),
            r in 0.0f64..400.0,
            s in 0.1f64..1.0,
            turn in 0.0f64..6.3,
        ) {
            let (camera, t, z) = (&case.camera, case.motion.translation, case.depth);
            prop_assume!(t.z.abs() > 1e-3 * z);
            let focus = focus_of_expansion(camera, &t).unwrap();
            let length = |r: f64| {
                let p = focus + Vector2::new(turn.cos(), turn.sin()) * r;
                translational_gradients(camera, &t, &p, z).unwrap().z.norm()
            };
            prop_assert!(length(r) <= length(r + s));
        }
    }
}
