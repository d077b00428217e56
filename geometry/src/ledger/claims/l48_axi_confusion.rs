//! L48: rotations that the axial loss takes for translations.

use crate::aligned_scene::AlignedScene;
use crate::alignment::Match;
use crate::flow::radial::radial_flow;
use crate::flow::rigid::rigid_flow;
use crate::ledger::responses::{Pixel, Plane};
use crate::ledger::{Case, Claim, Findings, Trial, Verdict};
use crate::loss_forms::axial;
use crate::observability::{axial_information, correlation};
use crate::scenes::{self, Reference, Scene};
use crate::sensitivity::{Response, axial_response};

pub(super) static CLAIM: Claim = Claim {
    id: "L48",
    slug: "axi-confusion",
    place: "derived from eq. la",
    statement: "To first order L_axi cannot tell a yaw error eps from an error z' eps of t'_x, nor a pitch error eps from an \
                error -z' eps of t'_y, where the aligned source depth z' is constant.",
    verdict: Verdict::Exact,
    condition: Some("first order in the error; over an image: constant z' = z + t'_z. Roll is not confused"),
    formula: "J_wy = z' J_tx,  J_wx = -z' J_ty at every pixel, for any f_u, f_v and any t'",
    derivation: "A yaw moves the unrotated point Q by (-z', 0, Q_x) eps and the flow by -f_u eps along u plus a multiple of d: \
                 the quadratic part of a rotational flow points along the radius, which a direction does not see. A step of \
                 t'_x moves it by -f_u / z' along u.",
    counter_example: None,
    correction: None,
    functions: &["sensitivity::axial_response", "observability::correlation"],
    taped: &["taped::align", "taped::so3_exp"],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    let f = &mut trial.findings;
    f.documented("t'_x that 0.1 deg of yaw looks like at 15 m, mm, documented", 15_000.0 * 0.1f64.to_radians(), 26.0, 1e-2);
    let handheld = scenes::handheld();
    let wall = Reference { scene: handheld.scene.at_depth(3.0), ..handheld.clone() };
    f.documented("correlation of yaw and t'_x, handheld, documented", correlated(&handheld, 1, 3), 0.9756, 1e-4);
    f.documented("correlation of yaw and t'_x, handheld before a wall, documented", correlated(&wall, 1, 3), 1.0, 1e-12);
    for k in 0..2 {
        f.bound(
            "wall, 1e-6 rad: loss of a rotation with the translation it looks like, over that of the rotation alone",
            cancelled(&wall, k, 1e-6),
            1e-6,
        );
    }
    f.gap(
        "room, where depth varies: loss that yaw and its t'_x at the mean depth leave, over that of the yaw alone",
        cancelled(&handheld, 1, 1e-6),
        0.21,
    );
    f.gap(
        "wall, 0.05 rad is not first order: loss that yaw and its t'_x leave, over that of the yaw alone",
        cancelled(&wall, 1, 0.05),
        0.19,
    );
    f.gap("wall, roll is not confused: 1 - |correlation of roll and t'_x|", 1.0 - correlated(&wall, 2, 3).abs(), 0.9);
    trial.count(handheld.scene.pixels.len());
}

fn correlated(reference: &Reference, i: usize, j: usize) -> f64 {
    let (scene, a) = (&reference.scene, reference.motion.translation_in_from_frame());
    let responses: Vec<Response> =
        scene.pixels.iter().zip(&scene.depths).map(|(p, &z)| axial_response(&scene.camera, &a, p, z)).collect();
    correlation(&axial_information(&responses, &vec![1.0; responses.len()]), i, j)
}

/// Axial loss with pitch (`k = 0`) or yaw (1) and the translation that undoes it at the mean depth, over the loss with the
/// rotation alone.
fn cancelled(reference: &Reference, k: usize, eps: f64) -> f64 {
    let a_z = reference.motion.translation_in_from_frame().z;
    let depth = mean_depth(&reference.scene) + a_z;
    let loss = |translation: f64| {
        let mut error = [0.0; 6];
        error[k] = eps;
        error[4 - k] = translation;
        AlignedScene::with_error(reference, &error).map_or(f64::NAN, |s| axial::pose_sign(&s.axial, &s.offsets, a_z))
    };
    loss(if k == 0 { depth * eps } else { -depth * eps }) / loss(0.0)
}

fn mean_depth(scene: &Scene) -> f64 {
    scene.depths.iter().sum::<f64>() / scene.depths.len() as f64
}

/// Both identities with responses that know nothing of them: forward mode and the tape.
fn at(case: &Case, f: &mut Findings) {
    let (a, z) = (case.in_target(), case.depth);
    let exact = rigid_flow(&case.camera, &case.motion, &case.pixel, z).zip(radial_flow(&case.camera, a.z, &case.pixel, z));
    let Some(((flow, source_depth), direction)) = exact else {
        return f.residual("point in front of the camera", f64::NAN, 1.0);
    };
    if direction.norm() < 0.1 {
        return;
    }
    let matched = Match { target: case.pixel, source: case.pixel + flow, source_depth };
    let pixel = Pixel { camera: &case.camera, rotation: &case.motion.rotation, a, matched, direction };
    let aligned_depth = z + a.z;
    let closed = axial_response(&case.camera, &a, &case.pixel, z);
    for (way, r) in [("forward mode", pixel.forward(Plane::Axial)), ("tape", pixel.taped(Plane::Axial)), ("closed form", closed)]
    {
        let scale = r[0].hypot(r[1]);
        f.equal(&format!("J_wy - z' J_tx, {way}, relative"), r[1], aligned_depth * r[3], scale, 1e-9);
        f.equal(&format!("J_wx + z' J_ty, {way}, relative"), r[0], -aligned_depth * r[4], scale, 1e-9);
    }
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
        fn before_any_wall_a_rotation_hides_behind_a_translation(
            depth in 2.0f64..20.0,
            k in 0usize..2,
            t in prop::array::uniform3(-0.2f64..0.2),
        ) {
            prop_assume!(t[2].abs() > 0.02);
            let motion = scenes::motion([0.01, -0.02, 0.015], t);
            let reference = Reference { name: "wall", scene: scenes::room().at_depth(depth), motion };
            let rest = cancelled(&reference, k, 1e-7);
            prop_assert!(rest < 1e-3, "{rest}");
        }
    }
}
