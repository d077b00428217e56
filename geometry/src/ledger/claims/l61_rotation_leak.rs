//! L61: what a rotation error does to the recovered translation.

use nalgebra::{Matrix3, Vector3};

use crate::Se3;
use crate::alignment::Convention;
use crate::ledger::{Claim, Draw, Findings, Trial, Verdict, estimates, forward};
use crate::losses::LossOptions;
use crate::recovery::{self, rotation_leak};
use crate::scenes::{self, Perturbed, Reference, Scene};
use crate::so3;

pub(super) static CLAIM: Claim = Claim {
    id: "L61",
    slug: "rotation-leak",
    place: "derived, for eqs. lt, lr",
    statement: "A rotation error enters the recovered translation multiplied by depth.",
    verdict: Verdict::FirstOrder,
    condition: Some("small angle, |t'| small beside the depths"),
    formula: "dt_x = -eps_y E[z (1 + x^2)] + eps_x E[z x y] + eps_z E[z y],  dt_y = eps_x E[z (1 + y^2)] - eps_y E[z x y] - \
              eps_z E[z x]; dt_z = -E[z d.g / r^2] with g the flow of the rotation error",
    derivation: "After the alignment with R exp(eps) the point is turned by -eps: to first order its flow changes by the \
                 rotational flow g of eps, whose ray components are -eps_y (1 + x^2) + eps_x x y + eps_z y and eps_x (1 + y^2) \
                 - eps_y x y - eps_z x. Multiply by z and average. Exact for the derivative at eps = 0, t' = 0.",
    counter_example: Some(
        "handheld, 0.1 degree of roll: the recovered t'_x, t'_y are off by (-0.0041, 0.1163) mm, the first order says (-0.0741, \
         0.2210) mm: its means nearly cancel, and terms of the order t' / z count.",
    ),
    correction: Some(
        "Terms of the relative size t' / z join the first order. Where the means of a row nearly cancel they are in charge: \
         there align with the wrong rotation and recover (`recovery::translation`).",
    ),
    functions: &["recovery::rotation_leak", "recovery::translation"],
    taped: &["taped::align", "taped::so3_exp"],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    let scenes = [scenes::road(), scenes::room()];
    for i in 0..(trial.samples / 50).max(4) {
        let scene = &scenes[i % 2];
        let (axis, direction, share) = (trial.draw.direction(), trial.draw.direction(), trial.draw.unit());
        finite(scene, axis, direction * share, &mut trial.findings);
        trial.count(scene.pixels.len());
    }
    for i in 0..(trial.samples / 200).max(2) {
        derivative(&scenes[i % 2], random_rotation(&mut trial.draw), &mut trial.findings);
        trial.count(scenes[i % 2].pixels.len());
    }
    documented(&mut trial.findings);
}

fn random_rotation(draw: &mut Draw) -> Vector3<f64> {
    draw.direction() * draw.uniform(0.0, 0.05)
}

/// Recovered minus true translation when the rotation alone is off by `eps`.
fn error(truth: &Perturbed, eps: Vector3<f64>) -> Vector3<f64> {
    let off = Perturbed { omega: so3::log(&(truth.rotation() * so3::exp(&eps))), ..truth.clone() };
    let flows = [off.planar_flows(), off.axial_flows()];
    let found = recovery::translation(&off.scene.camera, [&flows[0], &flows[1]], &off.scene.offsets(), &off.target_depths);
    found - truth.in_target
}

fn documented(f: &mut Findings) {
    let angle = 0.1f64.to_radians();
    let road = Perturbed::exact(&scenes::drive_next());
    let [pitch, yaw] = [Vector3::x(), Vector3::y()].map(|axis| error(&road, axis * angle));
    f.documented("road, 0.1 degree of yaw: error of t_x, documented", yaw.x, -0.0402754003467, 1e-8);
    f.documented("road, 0.1 degree of yaw: error of t_z, documented", yaw.z, -0.0301923978988, 1e-8);
    f.documented("road, 0.1 degree of pitch: error of t_y, documented", pitch.y, 0.0313040260867, 1e-8);
    f.gap("error of t_x over its true 0.02 m", yaw.x / 0.02, 1.8);
    let truth = Perturbed::exact(&scenes::handheld());
    let scene = &truth.scene;
    let predicted = rotation_leak(&scene.camera, &scene.pixels, &scene.depths) * Vector3::z() * angle;
    let missed = (error(&truth, Vector3::z() * angle) - predicted).xy().norm() / predicted.xy().norm();
    f.gap("handheld, 0.1 degree of roll: miss of the first order, relative", missed, 0.9 * 0.54);
}

/// An angle of 1e-5 rad and translations of up to 1 % of the nearest depth.
fn finite(scene: &Scene, axis: Vector3<f64>, share: Vector3<f64>, f: &mut Findings) {
    let nearest = scene.depths.iter().copied().fold(f64::INFINITY, f64::min);
    let in_target = share * (0.01 * nearest);
    let motion = scenes::motion([0.01, -0.02, 0.015], in_target.into());
    let truth = Perturbed::exact(&Reference { name: "slow", scene: scene.clone(), motion });
    let leak = rotation_leak(&scene.camera, &scene.pixels, &scene.depths);
    let eps = axis * 1e-5;
    let (found, predicted) = (error(&truth, eps), leak * eps);
    // Single entries may cancel: the size is that of the whole row times the angle.
    for k in 0..3 {
        let size = leak.row(k).norm() * 1e-5;
        let miss = (found[k] - predicted[k]).abs() / size;
        f.bound("1e-5 rad, |t'| < 0.01 z: |recovered error - first order|, relative", miss, 0.05);
    }
}

/// Without translation the first order is the derivative at `eps = 0`.
fn derivative(scene: &Scene, omega: Vector3<f64>, f: &mut Findings) {
    let motion = Se3 { rotation: so3::exp(&omega), translation: Vector3::zeros() };
    let truth = Perturbed::exact(&Reference { name: "turning", scene: scene.clone(), motion });
    let leak = rotation_leak(&scene.camera, &scene.pixels, &scene.depths);
    let closed: Vec<f64> = leak.row_iter().flat_map(|row| [row[0], row[1], row[2]]).collect();
    let dual = forward::jacobian([0.0; 3], |eps| recovered(&truth, eps));
    let central = forward::central([0.0; 3], [1e-5; 3], |eps| recovered(&truth, eps));
    let tape = taped(&truth);
    let tape: Vec<f64> = tape.row_iter().flat_map(|row| [row[0], row[1], row[2]]).collect();
    f.derivative("dt' / deps at t' = 0", &closed, Some(&dual), Some(&tape), Some(&central), leak.norm());
}

fn recovered<N: dimode_autodiff::proof::Number>(truth: &Perturbed, [x, y, z]: [N; 3]) -> [N; 3] {
    let o = N::zero();
    forward::pipeline::recovered_translation(truth, 0, [x, y, z, o, o, o, o, o, o, o])
}

/// The same on the tape, from the aligned flows of the pair.
fn taped(truth: &Perturbed) -> Matrix3<f64> {
    let options = LossOptions { convention: Convention::Consistent, ..LossOptions::literal() };
    let camera = truth.scene.grid_camera();
    let row = |k: usize| estimates::taped(truth, &options, |pair, _| estimates::recovered(pair, &camera, k)).eps.transpose();
    Matrix3::from_rows(&[row(0), row(1), row(2)])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::ledger::testing::holds;

    /// A vector of the unit ball, or a direction.
    fn vector() -> impl Strategy<Value = Vector3<f64>> {
        prop::array::uniform3(-1.0f64..1.0).prop_map(Vector3::from).prop_filter("in the ball", |v| (0.1..1.0).contains(&v.norm()))
    }

    proptest! {
        #[test]
        fn the_first_order_holds_at_small_angles(near in any::<bool>(), axis in vector(), share in vector()) {
            let scene = if near { scenes::room() } else { scenes::road() };
            holds(|f| finite(&scene, axis.normalize(), share, f))?;
        }

        #[test]
        fn the_derivative_is_exact_without_translation(near in any::<bool>(), omega in vector()) {
            let scene = if near { scenes::room() } else { scenes::road() };
            holds(|f| derivative(&scene, omega * 0.05, f))?;
        }
    }
}
