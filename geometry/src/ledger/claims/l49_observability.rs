//! L49: what the two direction losses can see of a rotation.

use nalgebra::Vector3;

use crate::alignment::Match;
use crate::flow::radial::radial_flow;
use crate::flow::tangential::tangential_flow;
use crate::ledger::responses::{Pixel, Plane, taped_response};
use crate::ledger::{Claim, Findings, Trial, Verdict};
use crate::observability::{Information, axial_information, planar_information, rotation_visibility};
use crate::scenes::{self, Reference};
use crate::sensitivity::{Response, axial_response, planar_response};

pub(super) static CLAIM: Claim = Claim {
    id: "L49",
    slug: "observability",
    place: "\"complementary\", text after eq. la",
    statement: "L_pla and L_axi constrain the rotation jointly and complement each other.",
    verdict: Verdict::Conditional,
    condition: Some("depth varies over the image"),
    formula: "G_axi = E[w^2 J J^T], G_pla = E[w^2 J J^T] - E[w^2 J] E[w^2 J]^T / E[w^2], w = |f|; translation marginalised: \
              G_ww - G_wa G_aa^+ G_aw",
    derivation: "With constant depth J_wy = z' J_tx and J_wx = -z' J_ty (L48): two rotations look exactly like translations to \
                 L_axi. With varied depth no translation imitates a rotation at every pixel. Information adds: the sum sees at \
                 least what each loss sees.",
    counter_example: Some(
        "handheld before a wall at 3 m: roots of the eigenvalues of L_axi alone 0, 0, 175 px per rad; L_pla 16.7, 39.4, 114; \
         both 16.7, 39.4, 209. In the room: L_axi 50.7, 74.8, 178, L_pla 25.3, 88.9, 131, both 58.4, 123, 216.",
    ),
    correction: Some(
        "Before a wall L_axi adds to roll alone: pitch and yaw rest on L_pla, whose view of them the sum does not improve. \
         They complement each other as far as depth varies over the image.",
    ),
    functions: &[
        "observability::axial_information",
        "observability::planar_information",
        "observability::rotation_information",
        "observability::rotation_visibility",
        "observability::correlation",
    ],
    taped: &["taped::align", "taped::so3_exp"],
    missing_way: Some("Central differences are taken of the responses (L47), of which these matrices are sums of products."),
    check,
};

/// Visibility of rotations to L_pla, L_axi and both, px per rad: varied depth, constant depth.
type Row = [[[f64; 3]; 3]; 2];

const TABLE: [Row; 4] = [
    [
        [[23.3, 133.0, 214.0], [88.9, 164.0, 224.0], [135.0, 233.0, 277.0]],
        [[12.0, 44.6, 106.0], [0.0, 0.0, 203.0], [12.0, 44.6, 229.0]],
    ],
    [
        [[23.7, 162.0, 193.0], [88.5, 163.0, 223.0], [113.0, 234.0, 284.0]],
        [[8.22, 34.4, 142.0], [0.0, 0.0, 202.0], [8.22, 34.4, 247.0]],
    ],
    [
        [[25.3, 88.9, 131.0], [50.7, 74.8, 178.0], [58.4, 123.0, 216.0]],
        [[16.7, 39.4, 114.0], [0.0, 0.0, 175.0], [16.7, 39.4, 209.0]],
    ],
    [
        [[29.8, 93.4, 155.0], [49.0, 72.3, 172.0], [59.6, 119.0, 230.0]],
        [[15.0, 31.3, 146.0], [0.0, 0.0, 169.0], [15.0, 31.3, 223.0]],
    ],
];

fn check(trial: &mut Trial) {
    let references = [(scenes::drive_next(), 15.0), (scenes::turn(), 15.0), (scenes::handheld(), 3.0), (scenes::lateral(), 3.0)];
    for ((reference, depth), row) in references.into_iter().zip(TABLE) {
        let wall = Reference { scene: reference.scene.at_depth(depth), ..reference.clone() };
        for (seen, expected) in [(&reference, row[0]), (&wall, row[1])] {
            documented(seen, expected, &mut trial.findings);
            at(seen, &mut trial.findings);
            trial.count(seen.scene.pixels.len());
        }
        let blind = rotation_visibility(&weighted(&wall, Plane::Axial)).iter().filter(|&&x| x < 1e-2).count();
        trial.findings.gap("wall: number of rotations that L_axi is blind to", blind as f64, 2.0);
        let alone = [Plane::Planar, Plane::Axial].map(|plane| rotation_visibility(&weighted(&wall, plane))[0]);
        trial.findings.gap("wall: share of the least visibility to L_pla that L_axi lacks", 1.0 - alone[1] / alone[0], 0.999);
    }
    information(&scenes::handheld(), &mut trial.findings);
}

fn documented(reference: &Reference, expected: [[f64; 3]; 3], f: &mut Findings) {
    let [planar, axial] = [Plane::Planar, Plane::Axial].map(|plane| weighted(reference, plane));
    for (information, expected) in [planar, axial, planar + axial].iter().zip(expected) {
        let found = rotation_visibility(information);
        for k in 0..3 {
            match expected[k] {
                // A root of rounding: 1e-12 of the largest eigenvalue is a millionth of its root.
                0.0 => f.residual("visibility of rotations that L_axi cannot see, px per rad", found[k], 1e-3),
                expected => f.documented("visibility of rotations, three digits, documented", found[k], expected, 5e-3),
            }
        }
    }
}

fn responses(reference: &Reference, plane: Plane) -> Vec<Response> {
    let (scene, a) = (&reference.scene, reference.motion.translation_in_from_frame());
    let of = if plane == Plane::Planar { planar_response } else { axial_response };
    scene.pixels.iter().zip(&scene.depths).map(|(p, &z)| of(&scene.camera, &a, p, z)).collect()
}

/// True aligned flows.
fn flows(reference: &Reference, plane: Plane) -> Vec<nalgebra::Vector2<f64>> {
    let (scene, a) = (&reference.scene, reference.motion.translation_in_from_frame());
    let one = |(p, &z): (&nalgebra::Vector2<f64>, &f64)| match plane {
        Plane::Planar => tangential_flow(&scene.camera, &a, z),
        Plane::Axial => radial_flow(&scene.camera, a.z, p, z).unwrap_or(nalgebra::Vector2::repeat(f64::NAN)),
    };
    scene.pixels.iter().zip(&scene.depths).map(one).collect()
}

fn gather(plane: Plane, responses: &[Response], weights: &[f64]) -> Information {
    if plane == Plane::Planar { planar_information(responses, weights) } else { axial_information(responses, weights) }
}

/// Information in pixels: responses weighted with the lengths of the flows.
fn weighted(reference: &Reference, plane: Plane) -> Information {
    let lengths: Vec<f64> = flows(reference, plane).iter().map(|f| f.norm()).collect();
    gather(plane, &responses(reference, plane), &lengths)
}

/// What holds for every motion and scene.
fn at(reference: &Reference, f: &mut Findings) {
    let [planar, axial] = [Plane::Planar, Plane::Axial].map(|plane| weighted(reference, plane));
    let [alone_pla, alone_axi, both] = [planar, axial, planar + axial].map(|g| rotation_visibility(&g));
    f.floor("least over largest visibility to both losses together", both[0] / both[2], 1e-3);
    for k in 0..3 {
        let alone = alone_pla[k].max(alone_axi[k]);
        // Equal where one loss adds nothing; 1e-12 of the largest eigenvalue is a millionth of its root.
        f.floor(
            "visibility to both losses - to the better one alone, relative to the largest",
            (both[k] - alone) / both[2],
            -1e-6,
        );
    }
}

/// The matrices of angles by forward mode and by the tape.
fn information(reference: &Reference, f: &mut Findings) {
    for (plane, what) in [(Plane::Planar, "6x6 information of L_pla"), (Plane::Axial, "6x6 information of L_axi")] {
        let closed = responses(reference, plane);
        let ones = vec![1.0; closed.len()];
        let information = gather(plane, &closed, &ones);
        let forward = gather(plane, &by_forward(reference, plane), &ones);
        let tape = by_tape(reference, plane, &closed);
        let scale = information.diagonal().max();
        f.derivative(what, information.as_slice(), Some(forward.as_slice()), Some(tape.as_slice()), None, scale);
    }
}

fn by_forward(reference: &Reference, plane: Plane) -> Vec<Response> {
    let (camera, motion) = (&reference.scene.camera, &reference.motion);
    let (matches, a) = (reference.scene.matches(motion), motion.translation_in_from_frame());
    let one = |(m, direction): (&Match, nalgebra::Vector2<f64>)| {
        Pixel { camera, rotation: &motion.rotation, a, matched: *m, direction }.forward(plane)
    };
    matches.iter().zip(flows(reference, plane)).map(one).collect()
}

/// Column `k` of `G`: the derivative of the angles, each weighted with its response to error `k` over their number; for L_pla
/// with the response beyond the mean one.
fn by_tape(reference: &Reference, plane: Plane, closed: &[Response]) -> Information {
    let (camera, motion) = (reference.scene.grid_camera(), &reference.motion);
    let matches = reference.scene.matches(motion);
    let step = scenes::STEP as f64;
    let n = matches.len();
    let flow: Vec<f64> = (0..2).flat_map(|c| matches.iter().map(move |m| (m.source[c] - m.target[c]) / step)).collect();
    let depth: Vec<f64> = matches.iter().map(|m| m.source_depth).collect();
    let a: Vector3<f64> = motion.translation_in_from_frame();
    let column = |k: usize| {
        let mean = if plane == Plane::Planar { closed.iter().map(|r| r[k]).sum::<f64>() / n as f64 } else { 0.0 };
        let weights: Vec<f64> = closed.iter().map(|r| (r[k] - mean) / n as f64).collect();
        nalgebra::Vector6::from(taped_response(&[camera], &motion.rotation, &a, [&flow, &depth], (plane, &weights)))
    };
    Information::from_columns(&[0, 1, 2, 3, 4, 5].map(column))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::ledger::testing::holds;

    fn motion() -> impl Strategy<Value = crate::Se3> {
        (prop::array::uniform3(-0.05f64..0.05), 0.0f64..6.3, 0.05f64..0.2, 0.05f64..0.3, any::<bool>()).prop_map(
            |(omega, turn, tangential, radial, ahead)| {
                let (sin, cos) = turn.sin_cos();
                scenes::motion(omega, [tangential * cos, tangential * sin, if ahead { -radial } else { radial }])
            },
        )
    }

    proptest! {
        #[test]
        fn together_they_see_every_rotation(motion in motion(), road in any::<bool>()) {
            let scene = if road { scenes::road() } else { scenes::room() };
            holds(|f| at(&Reference { name: "varied", scene, motion }, f))?;
        }

        #[test]
        fn before_every_wall_the_axial_loss_is_blind_to_two_rotations(motion in motion(), depth in 2.0f64..30.0) {
            let wall = Reference { name: "wall", scene: scenes::room().at_depth(depth), motion };
            let seen = rotation_visibility(&weighted(&wall, Plane::Axial));
            prop_assert!(seen[1] < 1e-4 * seen[2] && seen[2] > 1.0, "{seen}");
            holds(|f| at(&wall, f))?;
        }
    }
}
