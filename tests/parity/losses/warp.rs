//! Projection of depth maps and images read along it.

use dimode_autodiff::ops::bilinear_sample::SamplePadding;
use dimode_autodiff::{Scalar, Tape, Tensor, pixel_grid};
use dimode_geometry::taped::{
    Divisor, Pose, RotationForm, SampleGrid, back_project, project, rigid_flow, source_from_target, warp,
};

use crate::compared::Compared;
use crate::support::close;

/// Pixel coordinates `[n, 2, h, w]` divided by (size - 1) / 2 and moved to -1 .. 1, in the order sample, row, column, axis.
pub fn normalised<T: Scalar>(pixels: &Tensor<T>) -> Vec<f64> {
    let s = pixels.shape();
    let largest = [s.w() - 1, s.h() - 1];
    let at = |i: usize| {
        let (pixel, axis) = (i / 2, i % 2);
        let (n, p) = (pixel / s.plane(), pixel % s.plane());
        2.0 * (pixels.plane(n, axis)[p].to_f64() / largest[axis] as f64 - 0.5)
    };
    (0..s.len()).map(at).collect()
}

fn projected_in<T: Scalar>() {
    let golden = Compared::<T>::open("warp");
    let cameras = golden.cameras();
    let readings = [
        ("border_ac1", SamplePadding::Border, SampleGrid::Pixels),
        ("border_ac0", SamplePadding::Border, SampleGrid::HalfPixelAsCoded),
        ("zeros_ac1", SamplePadding::Zeros, SampleGrid::Pixels),
        ("zeros_ac0", SamplePadding::Zeros, SampleGrid::HalfPixelAsCoded),
    ];
    for (name, padding, grid) in readings {
        let tape = Tape::new();
        let [depth, image] = ["in.depth", "in.image"].map(|name| tape.leaf(golden.map(name)));
        let [turn, shift] = ["in.axisangle", "in.translation"].map(|name| tape.leaf(golden.vectors(name)));
        let Pose { rotation, translation } = source_from_target(turn, shift, false, RotationForm::Guarded);
        let points = back_project(depth, &cameras);
        golden.matches("out.cam_points", &points.value());
        let seen = project(points, rotation, translation, &cameras, Divisor::PlusGuard);
        golden.matches("out.pix", &seen.pixels.value());
        golden.matches("out.computed_depth", &seen.depth.value());
        golden.numbers_match("out.grid", &normalised(&seen.pixels.value()));
        golden.matches("out.rigid_flow", &seen.pixels.sub(tape.constant(pixel_grid(depth.shape()))).value());
        let warped = image.bilinear_sample(grid.coordinates(seen.pixels, 24, 32), padding);
        golden.matches(&format!("out.warped_{name}"), &warped.value());
        if name != "zeros_ac1" {
            let grads = tape.backward(warped.mul(tape.constant(golden.map("in.w"))).sum());
            let inputs = [("depth", depth), ("axisangle", turn), ("translation", shift), ("image", image)];
            golden.gradients_match(&format!("grad_{name}"), &grads, &inputs);
        }
    }
    golden.finish();
}

#[test]
fn projection_and_reading_as_coded() {
    projected_in::<f64>();
    projected_in::<f32>();
}

/// The reference guards its division by the depth with 1e-7, so the ends differ by that part of a coordinate.
#[test]
fn rigid_flow_leads_to_the_same_images_and_gradients() {
    let golden = Compared::<f64>::open("warp");
    let tape = Tape::new();
    let depth = tape.leaf(golden.map("in.depth"));
    let [turn, shift] = ["in.axisangle", "in.translation"].map(|name| tape.leaf(golden.vectors(name)));
    let Pose { rotation, translation } = source_from_target(turn, shift, false, RotationForm::Guarded);
    let flow = rigid_flow(depth, rotation, translation, &golden.cameras()).slice(1, 0, 2);
    let numbers = |name: &str| golden.golden().numbers(name).to_vec();
    for (padding, name) in [(SamplePadding::Border, "out.warped_border_ac1"), (SamplePadding::Zeros, "out.warped_zeros_ac1")] {
        let warped = warp(tape.constant(golden.map("in.image")), flow, padding);
        close(name, warped.value().data(), &numbers(name), 1e-5, 0.0);
    }
    let warped = warp(tape.constant(golden.map("in.image")), flow, SamplePadding::Border);
    let grads = tape.backward(warped.mul(tape.constant(golden.map("in.w"))).sum());
    for (input, name) in [(depth, "depth"), (turn, "axisangle"), (shift, "translation")] {
        let expected = numbers(&format!("grad_border_ac1.{name}"));
        let largest = expected.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        close(name, grads.wrt(input).data(), &expected, 1e-5 * largest, 0.0);
    }
}
