//! Poses of network outputs, and validity masks.

use crate::support::{close, open};
use dimode_autodiff::{Shape, Tape, Tensor};
use dimode_geometry::taped::pose::source_from_target;
use dimode_geometry::taped::{RotationForm, masks};
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

#[test]
fn masks_match() {
    let golden = open("flow_masks");
    let (forward, backward) = (golden.map("in.flow_fw"), golden.map("in.flow_bw"));
    let sampled = masks::backward_at_forward(&forward, &backward);
    close("bw_warped", sampled.data(), golden.numbers("out.bw_warped"), 1e-12, 1e-11);
    let occluded: Vec<f64> = masks::not_occluded(&forward, &backward).data().iter().map(|m| 1.0 - m).collect();
    assert_eq!(occluded, golden.numbers("out.occluded_fb"));
    assert_eq!(masks::in_view(&forward).to_vec(), golden.numbers("out.in_view"));
    let rigid = golden.map("in.rigid_flow");
    let still = masks::static_pixels(&rigid, &forward, None);
    assert_eq!(still.to_vec(), golden.numbers("out.static_px_per_image"));
}
