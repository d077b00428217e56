//! L12: flow of a small rotation.

use nalgebra::{Vector2, Vector3};

use crate::camera::Intrinsics;
use crate::flow::rotational::{rotational_flow, rotational_flow_first_order};
use crate::ledger::{Case, Claim, Findings, Trial, Verdict, forward, taped};
use crate::{scenes, so3};

pub(super) static CLAIM: Claim = Claim {
    id: "L12",
    slug: "rot-flow-first-order",
    place: "derived; the three components of the footnote",
    statement: "The flow of a rotation is the sum of the flows of its three components.",
    verdict: Verdict::FirstOrder,
    condition: Some("small angles: the error is at most 2 max(f) (1 + x^2 + y^2)^(3/2) |omega|^2 for |x|, |y| <= 1.2"),
    formula: "f_u (w_y (1 + x^2) - w_x x y - w_z y),  f_v (-w_x (1 + y^2) + w_y x y + w_z x)",
    derivation: "R b = b + omega x b + ..., and the derivative of (X / Z, Y / Z) at b = (x, y, 1) takes (a, b, c) to (a - x c, \
                 b - y c). The remainder is of second order: rotations do not add up, they are multiplied.",
    counter_example: Some(
        "Road grid, axis (0.6, -0.64, 0.48): the largest error is 0.0004 px at 0.001 rad, 0.040 px at 0.01 rad, 4.47 px at 0.1 \
         rad.",
    ),
    correction: Some("Beyond about 0.01 rad use the full rotational flow."),
    functions: &["flow::rotational::rotational_flow_first_order", "flow::rotational::rotational_flow"],
    taped: &["taped::rigid_flow", "taped::so3_exp"],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    let axis = Vector3::new(0.6, -0.64, 0.48);
    for (angle, expected) in [(0.001, 0.00039734761262305216), (0.01, 0.040143258933845884), (0.1, 4.465561589410346)] {
        let error = largest_error(&(axis * angle));
        trial.findings.documented("largest error on the road grid, documented", error, expected, 1e-8);
    }
    trial.findings.gap("largest error on the road grid at 0.1 rad, px", largest_error(&(axis * 0.1)), 4.0);
}

/// Distance of exact and first-order flow, pixels.
fn error(camera: &Intrinsics, omega: &Vector3<f64>, p: &Vector2<f64>) -> f64 {
    let exact = rotational_flow(camera, &so3::exp(omega), p).unwrap_or(Vector2::repeat(f64::NAN));
    (exact - rotational_flow_first_order(camera, omega, p)).norm()
}

/// The largest error on the road grid.
fn largest_error(omega: &Vector3<f64>) -> f64 {
    let scene = scenes::road();
    let errors = scene.pixels.iter().map(|p| error(&scene.camera, omega, p));
    errors.fold(0.0, |worst, e| if e.is_nan() || e > worst { e } else { worst })
}

fn at(case: &Case, f: &mut Findings) {
    let (camera, p) = (&case.camera, case.pixel);
    let (omega, ray) = (so3::log(&case.motion.rotation), camera.ray(p.x, p.y));
    slope_at_zero(camera, &p, f);
    sums(camera, &omega, &p, f);
    if ray.x.abs() > 1.2 || ray.y.abs() > 1.2 {
        return;
    }
    // The second term is the rounding of pixels.
    let bound = 2.0 * camera.fu.max(camera.fv) * ray.norm().powi(3) * omega.norm_squared() + 1e-10;
    f.bound("error / (2 max(f) |b|^3 angle^2 + rounding)", error(camera, &omega, &p) / bound, 1.0);
}

/// The first order is the derivative of the flow at no rotation.
fn slope_at_zero(camera: &Intrinsics, p: &Vector2<f64>, f: &mut Findings) {
    let columns = [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| rotational_flow_first_order(camera, &axis, p));
    let closed: Vec<f64> = (0..2).flat_map(|row| columns.map(|column| column[row])).collect();
    let still = [0.0; 3];
    let dual = forward::jacobian(still, |w| {
        let [z] = forward::fixed([1.0]);
        forward::rigid_flow(camera, w, forward::fixed(still), forward::fixed((*p).into()), z).0
    });
    let central = forward::central(still, [1e-6; 3], |w| forward::rigid_flow::<f64>(camera, w, still, (*p).into(), 1.0).0);
    let (_, rows) = taped::rigid_flow(camera, &Vector3::zeros(), &Vector3::zeros(), p, 1.0);
    let tape = [&rows[0][..3], &rows[1][..3]].concat();
    let scale = camera.fu.max(camera.fv);
    f.derivative("df/domega at no rotation", &closed, Some(&dual), Some(&tape), Some(&central), scale);
}

/// The first order adds up over the components.
fn sums(camera: &Intrinsics, omega: &Vector3<f64>, p: &Vector2<f64>, f: &mut Findings) {
    let flow = |omega: Vector3<f64>| rotational_flow_first_order(camera, &omega, p);
    let axis = |k: usize| Vector3::from_fn(|i, _| if i == k { omega[k] } else { 0.0 });
    let sum = flow(axis(0)) + flow(axis(1)) + flow(axis(2));
    f.residual("first order: sum over the components - whole, px", (sum - flow(*omega)).norm(), 1e-10);
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
        fn half_the_angle_leaves_a_quarter_of_the_error(case in case(), angle in 0.001f64..0.01) {
            let camera = case.camera;
            let ray = camera.ray(case.pixel.x, case.pixel.y).map(|x| x.clamp(-1.2, 1.2));
            let p = camera.project(&ray).unwrap();
            let omega = case.extra_direction(0) * angle;
            let (whole, half) = (error(&camera, &omega, &p), error(&camera, &(omega * 0.5), &p));
            // Third-order terms have the same bound with one more factor of angle and ray.
            let third = 8.0 * camera.fu.max(camera.fv) * ray.norm().powi(4) * angle.powi(3);
            prop_assert!((whole - 4.0 * half).abs() <= third + 1e-9, "{whole} {half} {third}");
        }
    }
}
