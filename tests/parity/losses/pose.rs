//! Poses of network outputs.

use crate::support::{close, open};
use dimode_autodiff::{Shape, Tape, Tensor};
use dimode_geometry::taped::RotationForm;
use dimode_geometry::taped::pose::source_from_target;
use dimode_tests::Golden;

const COUNT: usize = 5;

/// Splits stored 4x4 matrices into (N,1,3,3) and (N,3,1,1).
fn split(golden: &Golden, name: &str) -> [Tensor<f64>; 2] {
    let m = golden.numbers(name);
    [
        Tensor::from_fn(Shape::new(COUNT, 1, 3, 3), |n, _, i, j| m[16 * n + 4 * i + j]),
        Tensor::from_fn(Shape::new(COUNT, 3, 1, 1), |n, i, _, _| m[16 * n + 4 * i + 3]),
    ]
}

#[test]
fn guarded_axis_angle_matches_values_and_gradients() {
    let golden = open("pose");
    let tape = Tape::new();
    let vector = Shape::new(COUNT, 3, 1, 1);
    let w = tape.leaf(golden.tensor("in.axisangle", vector));
    let tau = tape.leaf(golden.tensor("in.translation", vector));
    let mut loss = tape.constant(Tensor::scalar(0.0));
    for (invert, stored, weights) in [(false, "out.T", "in.w"), (true, "out.T_inv", "in.w_inv")] {
        let pose = source_from_target(w, tau, invert, RotationForm::Guarded);
        let expected = split(&golden, stored);
        let weights = split(&golden, weights);
        for ((part, expected), weight) in [pose.rotation, pose.translation].into_iter().zip(expected).zip(weights) {
            close(stored, part.value().data(), expected.data(), 1e-13, 1e-12);
            loss = loss.add(part.mul(tape.constant(weight)).sum());
        }
    }
    let grads = tape.backward(loss);
    close("axisangle", grads.wrt(w).data(), golden.numbers("grad.axisangle"), 1e-12, 1e-8);
    close("translation", grads.wrt(tau).data(), golden.numbers("grad.translation"), 1e-12, 1e-10);
}

#[test]
fn exponential_form_differs_by_the_guard_only() {
    let golden = open("pose");
    let tape = Tape::new();
    let vector = Shape::new(COUNT, 3, 1, 1);
    let (w, tau) = (golden.tensor("in.axisangle", vector), golden.tensor("in.translation", vector));
    let pose = source_from_target(tape.leaf(w), tape.leaf(tau), false, RotationForm::Exponential);
    close("rotation", pose.rotation.value().data(), split(&golden, "out.T")[0].data(), 5e-7, 0.0);
    assert!(pose.to_se3().iter().all(|m| m.is_orthonormal(1e-14)));
}
