//! L10: how nonlinear the flow of a rotation is.

use nalgebra::{Matrix3, Vector2, Vector3};

use crate::camera::Intrinsics;
use crate::flow::rotational::{rotational_bend, rotational_flow};
use crate::flow::uniformity::{Uniformity, second_difference, uniformity};
use crate::homography::rotation_homography;
use crate::ledger::{Case, Claim, Findings, Trial, Verdict, forward};
use crate::{scenes, so3};

pub(super) static CLAIM: Claim = Claim {
    id: "L10",
    slug: "rot-flow-nonlinear",
    place: "text after eq. rotational_flow",
    statement: "A rotation gives a nonlinear and highly irregular flow.",
    verdict: Verdict::Conditional,
    condition: Some("nonlinear unless the axis is the optical axis: (h_31, h_32) != 0"),
    formula: "f(p - s) - 2 f(p) + f(p + s) = 2 dw (n dw - dn w) / [w (w^2 - dw^2)],  w = h_3 . p~, dw its change over the step s",
    derivation: "Along a line the pixel p_s is a quotient n / w of linear functions; its second difference has the factor dw = \
                 h_31 s_u + h_32 s_v. For a roll h_3 = (0, 0, 1) exactly, and the flow is affine. Otherwise the field is a \
                 quotient of a quadratic and a linear polynomial with three parameters: smooth, not irregular.",
    counter_example: Some(
        "Roll about the optical axis: second differences vanish. On the road grid one degree of yaw gives a mean flow of 8.084 \
         px and deviates from it by 1.515 px rms (19 %), pitch -6.579 px and 0.501 px (8 %): much like the tangential flow of a \
         wall.",
    ),
    correction: Some("Yaw and pitch look like a uniform shift with a smooth deviation of 8 to 19 %; roll is affine."),
    functions: &["flow::rotational::rotational_bend", "flow::uniformity::uniformity", "flow::uniformity::second_difference"],
    taped: &[],
    missing_way: None,
    check,
};

/// Steps of second differences, pixels.
const STEPS: [Vector2<f64>; 2] = [Vector2::new(16.0, 0.0), Vector2::new(0.0, 16.0)];

fn check(trial: &mut Trial) {
    trial.cases(at);
    let f = &mut trial.findings;
    let degree = 1f64.to_radians();
    let yaw = so3::exp(&Vector3::new(0.0, degree, 0.0));
    for (u, expected) in [(8.0, 10.8968890606), (320.0, 6.47932010135), (632.0, 11.2213926313)] {
        let flow = rotational_flow(&scenes::kitti640(), &yaw, &Vector2::new(u, 96.0)).map_or(f64::NAN, |flow| flow.x);
        f.documented("u-flow of one degree of yaw, documented", flow, expected, 1e-11);
    }
    let roll = rotational_flow(&scenes::kitti640(), &so3::exp(&Vector3::new(0.0, 0.0, 0.05)), &Vector2::new(451.0, 63.0));
    let roll = roll.unwrap_or(Vector2::repeat(f64::NAN));
    f.documented("flow of a roll at (451, 63), documented", roll.x, 1.4970502573, 1e-10);
    f.documented("flow of a roll at (451, 63), documented", roll.y, 6.54335898712, 1e-10);
    let fields = [
        (Vector3::y(), Vector2::new(8.084086806859881, 0.0), 1.51450988779987),
        (Vector3::x(), Vector2::new(0.0, -6.579129651346636), 0.50091405267014),
        (Vector3::z(), Vector2::zeros(), 3.34518184916942),
    ];
    for (axis, mean, deviation) in fields {
        let found = field(&(axis * degree));
        f.documented_within("mean flow of one degree on the road grid, documented, px", (found.mean - mean).norm(), 0.0, 1e-9);
        f.documented("deviation of one degree on the road grid, documented", found.rms_deviation, deviation, 1e-11);
    }
    let regular = |axis: Vector3<f64>| {
        let field = field(&(axis * degree));
        1.0 - field.rms_deviation / field.mean.norm()
    };
    f.gap("share of one degree of yaw that is a uniform shift", regular(Vector3::y()), 0.73);
    f.gap("share of one degree of pitch that is a uniform shift", regular(Vector3::x()), 0.83);
}

/// Flow of a rotation on the road grid.
fn field(omega: &Vector3<f64>) -> Uniformity {
    let (scene, rotation) = (scenes::road(), so3::exp(omega));
    let flow = |p: &Vector2<f64>| rotational_flow(&scene.camera, &rotation, p).unwrap_or(Vector2::repeat(f64::NAN));
    let flows: Vec<_> = scene.pixels.iter().map(flow).collect();
    uniformity(&flows).unwrap_or(Uniformity { mean: Vector2::repeat(f64::NAN), rms_deviation: f64::NAN })
}

fn at(case: &Case, f: &mut Findings) {
    let (camera, p) = (&case.camera, case.pixel);
    for step in STEPS {
        compare(camera, &so3::log(&case.motion.rotation), &p, &step, f);
    }
    let angle = case.extra(0, 0.01, 0.2) * if case.extra[1] < 0.5 { -1.0 } else { 1.0 };
    let bend = |axis: Vector3<f64>, step| written_out(camera, &(axis * angle), &p, &step);
    for step in STEPS {
        f.residual("roll: second differences along u and v, px", bend(Vector3::z(), step).norm(), 1e-10);
    }
    f.floor("yaw above 0.01 rad: second difference along u, px", bend(Vector3::y(), STEPS[0]).norm(), 1e-6);
    f.floor("pitch above 0.01 rad: second difference along v, px", bend(Vector3::x(), STEPS[1]).norm(), 1e-6);
    let h = rotation_homography(camera, &so3::exp(&(Vector3::z() * angle)));
    f.residual("roll: h_3 - (0, 0, 1)", (h.row(2) - Matrix3::<f64>::identity().row(2)).norm(), 0.0);
}

/// Second difference of the flow by the closed form, from the three flows, and written out once more.
fn compare(camera: &Intrinsics, omega: &Vector3<f64>, p: &Vector2<f64>, step: &Vector2<f64>, f: &mut Findings) {
    let rotation = so3::exp(omega);
    let bend = rotational_bend(&rotation_homography(camera, &rotation), p, step).unwrap_or(Vector2::repeat(f64::NAN));
    let flow = |p: Vector2<f64>| rotational_flow(camera, &rotation, &p).unwrap_or(Vector2::repeat(f64::NAN));
    let difference = second_difference(&flow(p - step), &flow(*p), &flow(p + step));
    f.residual("bend - second difference of the closed flow, px", (bend - difference).norm(), 1e-10);
    f.residual("bend - second difference written out, px", (bend - written_out(camera, omega, p, step)).norm(), 1e-10);
}

fn written_out(camera: &Intrinsics, omega: &Vector3<f64>, p: &Vector2<f64>, step: &Vector2<f64>) -> Vector2<f64> {
    let flow = |p: Vector2<f64>| Vector2::from(forward::rigid_flow::<f64>(camera, (*omega).into(), [0.0; 3], p.into(), 1.0).0);
    flow(p - step) - flow(*p) * 2.0 + flow(p + step)
}

#[cfg(test)]
mod tests {
    crate::ledger::testing::tests_on_cases!(super::at);
}
