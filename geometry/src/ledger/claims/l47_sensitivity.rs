//! L47: first-order responses of both losses to the six errors.

use crate::aligned_scene::AlignedScene;
use crate::alignment::Match;
use crate::flow::radial::radial_flow;
use crate::flow::rigid::rigid_flow;
use crate::flow::tangential::tangential_flow;
use crate::ledger::responses::{Pixel, Plane};
use crate::ledger::{Case, Claim, Findings, Trial, Verdict};
use crate::loss_forms::{axial, planar};
use crate::scenes::{self, Reference};
use crate::sensitivity::{Response, axial_response, mean_magnitude, planar_response, spread};

pub(super) static CLAIM: Claim = Claim {
    id: "L47",
    slug: "sensitivity",
    place: "\"complementary\", text after eq. la",
    statement: "Near the truth L_pla = eps^2 A^2 and L_axi = |eps| B for an error eps of one of the six motion parameters.",
    verdict: Verdict::FirstOrder,
    condition: Some("eps A and eps B far below 1 rad"),
    formula: "axial: J_tx = -f_u d_v / (t'_z r^2), J_ty = f_v d_u / (t'_z r^2), J_wx = -z' J_ty, J_wy = z' J_tx, J_wz = (f_v \
              d_u X' + f_u d_v Y') / (t'_z r^2); planar: J_tz = (F x d) / |F|^2, J_w = F x [f o (q_xy - Q_xy q_z / z)] / \
              |F|^2; A = std(J), B = E|J|",
    derivation: "An error turns an aligned flow f by f x df / |f|^2. The circular variance is the variance of these angles to \
                 second order, the axial loss the mean of their magnitudes. L_pla does not contain t'_x, t'_y, L_axi does not \
                 contain t'_z.",
    counter_example: Some(
        "drive_next, 0.1 deg about x: eps^2 A^2 = 0.978, the circular loss is 0.217: tangential flow is too short for a \
         first-order statement.",
    ),
    correction: Some(
        "First order needs eps A and eps B below about 0.1 rad; in drive_next, with A = 567 and B = 45 per rad, that is 0.01 \
         degree of rotation for L_pla and 0.1 degree for L_axi. Beyond it only the losses themselves tell: the circular one \
         ends at 2, the angle at pi.",
    ),
    functions: &[
        "sensitivity::planar_response",
        "sensitivity::axial_response",
        "sensitivity::spread",
        "sensitivity::mean_magnitude",
        "sensitivity::root_mean_square",
    ],
    taped: &["taped::align", "taped::so3_exp"],
    missing_way: None,
    check,
};

/// `A` and `B` of three references, errors `w_x, w_y, w_z, t'_x, t'_y, t'_z`.
const TABLE: [[Response; 2]; 3] = [
    [
        [566.569273003, 420.78069082, 474.189767549, 0.0, 0.0, 11.5682395163],
        [44.8105901647, 23.5182058743, 22.7499307635, 2.03179396293, 3.16346603287, 0.0],
    ],
    [
        [10.7896880808, 7.68304779018, 15.5009308347, 0.0, 0.0, 3.71488580524],
        [84.4068897864, 69.2905376102, 37.4685349009, 25.1617392983, 31.5877199823, 0.0],
    ],
    [
        [7.99498131521, 2.16634366657, 9.81543426964, 0.0, 0.0, 1.74453717395],
        [350.262647139, 287.22684616, 150.058852586, 100.646957193, 126.350879929, 0.0],
    ],
];

/// Circular planar and sign-aware axial loss with 0.1 deg about x, y and z.
const FINITE: [[[f64; 2]; 3]; 3] = [
    [[0.216683, 0.0822825], [0.713805, 0.0386374], [0.53165, 0.0396393]],
    [[0.00028833, 0.152617], [0.000242635, 0.116602], [0.000733478, 0.0652953]],
    [[0.000185592, 0.622085], [1.63081e-05, 0.640028], [0.000294806, 0.255486]],
];

fn check(trial: &mut Trial) {
    trial.cases(at);
    let f = &mut trial.findings;
    for (i, reference) in [scenes::drive_next(), scenes::handheld(), scenes::lateral()].iter().enumerate() {
        let [a, b] = predicted(reference);
        for k in 0..6 {
            f.documented("A of the references, documented", a[k], TABLE[i][0][k], 1e-11);
            f.documented("B of the references, documented", b[k], TABLE[i][1][k], 1e-11);
            small(reference, k, [a[k], b[k]], f);
        }
        for (k, expected) in FINITE[i].iter().enumerate() {
            let [planar, axial] = losses(reference, k, 0.1f64.to_radians());
            f.documented("losses with 0.1 deg, documented", planar, expected[0], 1e-5);
            f.documented("losses with 0.1 deg, documented", axial, expected[1], 1e-5);
        }
    }
    let [a, _] = predicted(&scenes::drive_next());
    let eps = 0.1f64.to_radians();
    f.gap(
        "drive_next, 0.1 deg about x: eps^2 A^2 - circular loss, rad^2",
        (eps * a[0]).powi(2) - losses(&scenes::drive_next(), 0, eps)[0],
        0.68,
    );
    trial.count(3 * scenes::room().pixels.len());
}

/// `A` and `B` of the closed forms.
fn predicted(reference: &Reference) -> [Response; 2] {
    let (scene, a) = (&reference.scene, reference.motion.translation_in_from_frame());
    let all = |of: fn(&_, &_, &_, f64) -> Response| -> Vec<Response> {
        scene.pixels.iter().zip(&scene.depths).map(|(p, &z)| of(&scene.camera, &a, p, z)).collect()
    };
    [spread(&all(planar_response)), mean_magnitude(&all(axial_response))]
}

/// Circular planar and sign-aware axial loss with one error.
fn losses(reference: &Reference, k: usize, size: f64) -> [f64; 2] {
    let mut error = [0.0; 6];
    error[k] = size;
    let a_z = reference.motion.translation_in_from_frame().z;
    let seen = AlignedScene::with_error(reference, &error);
    seen.map_or([f64::NAN; 2], |s| [planar::circular(&s.planar), axial::pose_sign(&s.axial, &s.offsets, a_z)])
}

/// The losses themselves with an error that turns the flows by some 1e-5 rad; the mean of both signs, in which odd terms cancel.
fn small(reference: &Reference, k: usize, [a, b]: [f64; 2], f: &mut Findings) {
    let at = |size: f64| {
        let (above, below) = (losses(reference, k, size), losses(reference, k, -size));
        [0, 1].map(|i| (above[i] + below[i]) / 2.0)
    };
    if a > 0.0 {
        let eps = 3e-5 / a;
        let miss = (at(eps)[0] / (eps * a).powi(2) - 1.0).abs();
        f.bound("eps A = 3e-5 rad: |circular loss / eps^2 A^2 - 1|", miss, 1e-5);
    } else {
        f.residual("circular loss with an error of t'_x or t'_y", at(0.01)[0], 1e-9);
    }
    if b > 0.0 {
        let eps = 3e-5 / b;
        f.bound("eps B = 3e-5 rad: |axial loss / |eps| B - 1|", (at(eps)[1] / (eps * b) - 1.0).abs(), 1e-5);
    } else {
        f.residual("axial loss with an error of t'_z, rad", at(0.01)[1], 1e-9);
    }
}

/// Flows shorter than this, in pixels, have no direction that rounding would leave alone.
const SHORTEST: f64 = 0.1;

fn at(case: &Case, f: &mut Findings) {
    let (a, z) = (case.in_target(), case.depth);
    let exact = rigid_flow(&case.camera, &case.motion, &case.pixel, z).zip(radial_flow(&case.camera, a.z, &case.pixel, z));
    let Some(((flow, source_depth), radial)) = exact else {
        return f.residual("point in front of the camera", f64::NAN, 1.0);
    };
    let matched = Match { target: case.pixel, source: case.pixel + flow, source_depth };
    let directions = [(Plane::Planar, tangential_flow(&case.camera, &a, z)), (Plane::Axial, radial)];
    for (plane, direction) in directions {
        if direction.norm() < SHORTEST {
            continue;
        }
        let pixel = Pixel { camera: &case.camera, rotation: &case.motion.rotation, a, matched, direction };
        let (what, closed) = match plane {
            Plane::Planar => ("d theta_pla / d(w, z delta)", planar_response(&case.camera, &a, &case.pixel, z)),
            Plane::Axial => ("d theta_axi / d(w, z delta)", axial_response(&case.camera, &a, &case.pixel, z)),
        };
        let (forward, tape, central) = (pixel.forward(plane), pixel.taped(plane), pixel.central(plane, &closed));
        let [closed, forward, tape, central] = [closed, forward, tape, central].map(|r| in_depths(&r, z));
        let scale = closed.iter().fold(0.0f64, |m, x| m.max(x.abs()));
        f.derivative(what, &closed, Some(&forward), Some(&tape), Some(&central), scale);
    }
}

/// Translations counted in depths, so that all six responses are rad per unit of one size.
fn in_depths(response: &Response, z: f64) -> Response {
    std::array::from_fn(|k| if k < 3 { response[k] } else { response[k] * z })
}

#[cfg(test)]
mod tests {
    crate::ledger::testing::tests_on_cases!(super::at);
}
