//! Warped images against reference values and gradients.

use crate::support::{cameras, close, open};
use dimode_autodiff::ops::bilinear_sample::SamplePadding;
use dimode_autodiff::{Shape, Tape, Tensor, pixel_grid};
use dimode_geometry::taped::{Pose, RotationForm, rigid_flow, source_from_target, warp};
use dimode_tests::Golden;

/// The flow whose ends the reference has sampled.
fn flow(golden: &Golden) -> Tensor<f64> {
    let ends = golden.map::<f64>("out.pix");
    let grid = pixel_grid::<f64>(ends.shape());
    Tensor::from_vec(ends.shape(), ends.data().iter().zip(grid.data()).map(|(end, p)| end - p).collect())
}

#[test]
fn warped_images_match_with_either_padding() {
    let golden = open("warp");
    let tape = Tape::new();
    let (image, flow) = (tape.constant(golden.map("in.image")), tape.constant(flow(&golden)));
    for (padding, name) in [(SamplePadding::Border, "out.warped_border_ac1"), (SamplePadding::Zeros, "out.warped_zeros_ac1")] {
        close(name, warp(image, flow, padding).value().data(), golden.numbers(name), 1e-12, 1e-12);
    }
}

#[test]
fn the_image_gradient_matches() {
    let golden = open("warp");
    let tape = Tape::new();
    let image = tape.leaf(golden.map("in.image"));
    let warped = warp(image, tape.constant(flow(&golden)), SamplePadding::Border);
    let grads = tape.backward(warped.mul(tape.constant(golden.map("in.w"))).sum());
    close("image", grads.wrt(image).data(), golden.numbers("grad_border_ac1.image"), 1e-12, 1e-11);
}

/// The reference guards its division by the depth with 1e-7, so the ends differ by that part of a coordinate.
#[test]
fn the_gradients_through_the_rigid_flow_match() {
    let golden = open("warp");
    let tape = Tape::new();
    let vector = Shape::new(2, 3, 1, 1);
    let depth = tape.leaf(golden.map("in.depth"));
    let [turn, shift] = ["in.axisangle", "in.translation"].map(|name| tape.leaf(golden.tensor(name, vector)));
    let Pose { rotation, translation } = source_from_target(turn, shift, false, RotationForm::Guarded);
    let flow = rigid_flow(depth, rotation, translation, &cameras(&golden)).slice(1, 0, 2);
    let warped = warp(tape.constant(golden.map("in.image")), flow, SamplePadding::Border);
    close("warped", warped.value().data(), golden.numbers("out.warped_border_ac1"), 1e-5, 0.0);
    let grads = tape.backward(warped.mul(tape.constant(golden.map("in.w"))).sum());
    for (input, name) in [(depth, "depth"), (turn, "axisangle"), (shift, "translation")] {
        let expected = golden.numbers(&format!("grad_border_ac1.{name}"));
        let largest = expected.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        close(name, grads.wrt(input).data(), expected, 1e-5 * largest, 0.0);
    }
}
