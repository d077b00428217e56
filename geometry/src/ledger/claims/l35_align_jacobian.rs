//! L35: derivatives of the aligned flows.

use nalgebra::{Vector2, Vector3};

use super::l24_residual_rows::estimate;
use crate::alignment::{AlignmentJacobian, Match, axial_jacobian, planar_jacobian, unrotated_point};
use crate::camera::Intrinsics;
use crate::ledger::{Case, Claim, Findings, Trial, Verdict, forward, taped};
use crate::motion::{radial_part, tangential_part};
use crate::{scenes, so3};

pub(super) static CLAIM: Claim = Claim {
    id: "L35",
    slug: "align-jacobian",
    place: "derived, for the backward pass",
    statement: "df/deps = J [Q0]_x, df/dt'_hat = -J on the removed components and 0 on the others, df/dz_s = J R_hat^T b(p_s).",
    verdict: Verdict::Exact,
    condition: Some("Q_z > 0; rotations move as R_hat exp([eps]_x)"),
    formula: "Q0 = R_hat^T p_s^C, Q = Q0 - part(t'_hat), J = [[f_u / Q_z, 0, -f_u Q_x / Q_z^2], [0, f_v / Q_z, -f_v Q_y / \
         Q_z^2]]",
    derivation: "J is the derivative of the projection. (R_hat exp([eps]_x))^T p = exp(-[eps]_x) Q0 = Q0 + Q0 x eps: derivative \
         [Q0]_x. part(t'_hat) enters with a minus, and Q0 is linear in the source depth.",
    counter_example: None,
    correction: None,
    functions: &["alignment::planar_jacobian", "alignment::axial_jacobian"],
    taped: &["taped::so3_exp", "taped::align"],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    let hand = scenes::handheld();
    let camera = &hand.scene.camera;
    let exact = hand.scene.matches(&hand.motion)[100];
    let m = Match { source_depth: exact.source_depth * 1.03, ..exact };
    let (r, a) = (so3::exp(&Vector3::new(0.032, -0.047, 0.021)), Vector3::new(0.066, 0.037, -0.085));
    let (pla, axi) = (planar_jacobian(camera, &r, &a, &m), axial_jacobian(camera, &r, &a, &m));
    let found =
        [pla.translation[(0, 2)], pla.translation[(1, 2)], axi.rotation[(0, 0)], axi.rotation[(0, 1)], axi.rotation[(0, 2)]];
    for (found, expected) in found.into_iter().zip([-39.9151020004, -18.447246261, 39.6614409565, -486.24625546, -84.0476472354])
    {
        trial.findings.documented("derivatives of a hand-held pixel, documented", found, expected, 1e-11);
    }
}

/// Rows u and v by the rotation (3), the translation (3) and the source depth (1).
fn entries(j: &AlignmentJacobian) -> [[f64; 7]; 2] {
    std::array::from_fn(|row| {
        std::array::from_fn(|k| match k {
            0..3 => j.rotation[(row, k)],
            3..6 => j.translation[(row, k - 3)],
            _ => j.source_depth[row],
        })
    })
}

fn at(case: &Case, f: &mut Findings) {
    let Some(exact) = case.exact_match() else {
        return f.residual("point in front of the camera", f64::NAN, 1.0);
    };
    let (guess, m) = (estimate(case), Match { source_depth: exact.source_depth * case.extra(6, 0.9, 1.1), ..exact });
    let (camera, a, w) = (&case.camera, guess.translation_in_from_frame(), so3::log(&guess.rotation));
    let start = unrotated_point(camera, &guess.rotation, &m);
    let points = [start - radial_part(&a), start - tangential_part(&a)];
    // Estimates can bring an aligned point behind the camera, where there is no flow.
    if points.iter().any(|q| q.z <= 0.1 * case.depth) {
        return;
    }
    let closed = [planar_jacobian(camera, &guess.rotation, &a, &m), axial_jacobian(camera, &guess.rotation, &a, &m)];
    let tape = tape(camera, &w, &a, &m);
    for (k, what) in ["df_pla", "df_axi"].into_iter().enumerate() {
        let q = points[k];
        // |J| is at most this; it is applied to arms of length |Q0|, 1 and |Q0| / z_s.
        let projection = camera.fu.max(camera.fv) * q.norm() / (q.z * q.z);
        let arms = [start.norm(), 1.0, start.norm() / m.source_depth];
        let (forward, central) = other_ways(camera, [w, a], &m, k, case.depth);
        let closed = entries(&closed[k]);
        for (input, columns) in [("deps", 0..3), ("dt'", 3..6), ("dz_s", 6..7)].into_iter() {
            let pick = |rows: &dyn Fn(usize, usize) -> f64| -> Vec<f64> {
                (0..2).flat_map(|row| columns.clone().map(move |c| (row, c))).map(|(row, c)| rows(row, c)).collect()
            };
            let arm = arms[columns.start / 3];
            f.derivative(
                &format!("{what} / {input}"),
                &pick(&|row, c| closed[row][c]),
                Some(&pick(&|row, c| forward[7 * row + c])),
                Some(&pick(&|row, c| tape[2 * k + row][c])),
                Some(&pick(&|row, c| central[7 * row + c])),
                projection * arm,
            );
        }
    }
}

/// Forward mode and central differences of the planar (0) or axial (1) flow, 7 derivatives a row.
fn other_ways(camera: &Intrinsics, [w, a]: [Vector3<f64>; 2], m: &Match, k: usize, z: f64) -> (Vec<f64>, Vec<f64>) {
    let removed = [[0.0, 0.0, 1.0], [1.0, 1.0, 0.0]][k];
    let pixels: [[f64; 2]; 2] = [m.target.into(), m.source.into()];
    let x = [0.0, 0.0, 0.0, a.x, a.y, a.z, m.source_depth];
    let forward = forward::jacobian(x, |[e0, e1, e2, a0, a1, a2, depth]| {
        let part =
            [a0 * forward::fixed([removed[0]])[0], a1 * forward::fixed([removed[1]])[0], a2 * forward::fixed([removed[2]])[0]];
        forward::aligned(camera, [forward::fixed(w.into()), [e0, e1, e2]], part, pixels.map(forward::fixed), depth).0
    });
    let steps = [1e-6, 1e-6, 1e-6, 1e-6 * z, 1e-6 * z, 1e-6 * z, 1e-6 * z];
    let central = forward::central(x, steps, |[e0, e1, e2, a0, a1, a2, depth]| {
        let part = [a0 * removed[0], a1 * removed[1], a2 * removed[2]];
        forward::aligned::<f64>(camera, [w.into(), [e0, e1, e2]], part, pixels, depth).0
    });
    (forward, central)
}

/// Rows of `f_pla` u, v and `f_axi` u, v on the tape, 7 derivatives each.
fn tape(camera: &Intrinsics, w: &Vector3<f64>, a: &Vector3<f64>, m: &Match) -> Vec<Vec<f64>> {
    let one_pixel = [taped::pixel_camera(camera, &m.target)];
    let flow: Vector2<f64> = m.source - m.target;
    let inputs = [taped::column(&[0.0; 3]), taped::column(a.as_slice()), taped::column(&[m.source_depth])];
    let (_, rows) = taped::jacobian(&inputs, |v| {
        let tape = v[0].tape();
        let base = crate::taped::so3_exp(tape.constant(taped::column(w.as_slice())));
        let rotation = base.matmul(crate::taped::so3_exp(v[0]));
        let flow = tape.constant(taped::column(flow.as_slice()));
        crate::taped::align(v[2], rotation, v[1], flow, &one_pixel).slice(1, 0, 4)
    });
    rows
}

#[cfg(test)]
mod tests {
    crate::ledger::testing::tests_on_cases!(super::at);
}
