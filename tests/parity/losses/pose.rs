//! Poses of network outputs.

use crate::compared::Compared;
use crate::support::{close, open};
use dimode_autodiff::{Scalar, Shape, Tape, Tensor};
use dimode_geometry::taped::so3_exp::rotation_matrix;
use dimode_geometry::taped::{Pose, RotationForm, source_from_target};
use dimode_tests::Golden;

const COUNT: usize = 5;

/// Splits stored 4x4 matrices into (N,1,3,3) and (N,3,1,1).
fn split<T: Scalar>(golden: &Golden, name: &str) -> [Tensor<T>; 2] {
    let m = golden.numbers(name);
    [
        Tensor::from_fn(Shape::new(COUNT, 1, 3, 3), |n, _, i, j| T::from_f64(m[16 * n + 4 * i + j])),
        Tensor::from_fn(Shape::new(COUNT, 3, 1, 1), |n, i, _, _| T::from_f64(m[16 * n + 4 * i + 3])),
    ]
}

/// The 4x4 matrices of poses, in the stored order.
fn matrices<T: Scalar>(pose: Pose<'_, T>) -> Vec<f64> {
    let (r, t) = (pose.rotation.value(), pose.translation.value());
    let entry = |n: usize, i: usize, j: usize| match (i, j) {
        (3, 3) => 1.0,
        (3, _) => 0.0,
        (_, 3) => t.at(n, i, 0, 0).to_f64(),
        _ => r.at(n, 0, i, j).to_f64(),
    };
    (0..16 * COUNT).map(|k| entry(k / 16, k / 4 % 4, k % 4)).collect()
}

fn poses_in<T: Scalar>() {
    let golden = Compared::<T>::open("pose");
    let tape = Tape::new();
    let [w, tau, angles] = ["in.axisangle", "in.translation", "in.euler"].map(|name| tape.leaf(golden.vectors(name)));
    let mut loss = tape.constant(Tensor::scalar(T::ZERO));
    for (invert, stored, weights) in [(false, "out.T", "in.w"), (true, "out.T_inv", "in.w_inv")] {
        let pose = source_from_target(w, tau, invert, RotationForm::Guarded);
        golden.numbers_match(stored, &matrices(pose));
        for (part, weight) in [pose.rotation, pose.translation].into_iter().zip(split(golden.golden(), weights)) {
            loss = loss.add(part.mul(tape.constant(weight)).sum());
        }
    }
    golden.gradients_match("grad", &tape.backward(loss), &[("axisangle", w), ("translation", tau)]);
    let rotation = rotation_matrix(angles, RotationForm::Euler);
    golden.matches("out.R_euler", &rotation.value());
    let weights = golden.golden().tensor("in.w_euler", rotation.shape());
    let grads = tape.backward(rotation.mul(tape.constant(weights)).sum());
    golden.gradients_match("grad", &grads, &[("euler", angles)]);
    golden.finish();
}

#[test]
fn guarded_axis_angle_and_euler_angles_match_values_and_gradients() {
    poses_in::<f64>();
    poses_in::<f32>();
}

#[test]
fn exponential_form_differs_by_the_guard_only() {
    let golden = open("pose");
    let tape = Tape::new();
    let vector = Shape::new(COUNT, 3, 1, 1);
    let (w, tau) = (golden.tensor("in.axisangle", vector), golden.tensor("in.translation", vector));
    let pose = source_from_target(tape.leaf(w), tape.leaf(tau), false, RotationForm::Exponential);
    close("rotation", pose.rotation.value().data(), split::<f64>(&golden, "out.T")[0].data(), 5e-7, 0.0);
    assert!(pose.to_se3().iter().all(|m| m.is_orthonormal(1e-14)));
}
