//! Warping, and structural dissimilarity from box means.

use dimode_autodiff::ops::bilinear_sample::SamplePadding;
use dimode_autodiff::{Gradients, Shape, Tape, Tensor, Var};
use dimode_tests::Golden;

use crate::support::{close_to_scale, open};

fn warp<'t>(tape: &'t Tape<f64>, golden: &Golden, padding: SamplePadding) -> [Var<'t, f64>; 3] {
    let image = tape.leaf(golden.map("in.image"));
    let coords = tape.leaf(golden.map("out.pix"));
    [image, coords, image.bilinear_sample(coords, padding)]
}

#[test]
fn warped_images_match_with_either_padding() {
    let golden = open("warp");
    let tape = Tape::new();
    for (padding, name) in [(SamplePadding::Border, "out.warped_border_ac1"), (SamplePadding::Zeros, "out.warped_zeros_ac1")] {
        let [_, _, warped] = warp(&tape, &golden, padding);
        close_to_scale(name, warped.value().data(), golden.numbers(name), 1e-12);
    }
}

fn weighted_gradients(tape: &Tape<f64>, warped: Var<'_, f64>, weights: Tensor<f64>) -> Gradients<f64> {
    let shape = warped.shape();
    assert_eq!(shape, weights.shape());
    tape.backward(warped.mul(warped.tape().constant(weights)).sum())
}

#[test]
fn the_image_gradient_matches() {
    let golden = open("warp");
    let tape = Tape::new();
    let [image, _, warped] = warp(&tape, &golden, SamplePadding::Border);
    let grads = weighted_gradients(&tape, warped, golden.map("in.w"));
    close_to_scale("image", grads.wrt(image).data(), golden.numbers("grad_border_ac1.image"), 1e-12);
}

/// The coordinates depend on the depth as pix = (D a + b)_xy / ((D a + b)_z + 1e-7) with b = K t, so with
/// y = pix (y_z + 1e-7) the derivative of pix by D is (a_xy - pix a_z) / (y_z + 1e-7), where D a = y - b.
#[test]
fn the_coordinate_gradient_matches_through_the_depth() {
    let golden = open("warp");
    let tape = Tape::new();
    let [_, coords, warped] = warp(&tape, &golden, SamplePadding::Border);
    let by_coords = weighted_gradients(&tape, warped, golden.map("in.w")).wrt(coords);
    let [pix, depth, third] = ["out.pix", "in.depth", "out.computed_depth"].map(|name| golden.map::<f64>(name));
    let k = golden.tensor::<f64>("in.K", Shape::new(2, 1, 3, 3));
    let t = golden.tensor::<f64>("in.translation", Shape::new(2, 3, 1, 1));
    let by_depth = Tensor::from_fn(depth.shape(), |n, _, v, u| {
        let b = |row| (0..3).map(|j| k.at(n, 0, row, j) * t.at(n, j, 0, 0)).sum::<f64>();
        let (d, z) = (depth.at(n, 0, v, u), third.at(n, 0, v, u));
        let along = |axis: usize| {
            let p = pix.at(n, axis, v, u);
            let (a, a_z) = ((p * (z + 1e-7) - b(axis)) / d, (z - b(2)) / d);
            by_coords.at(n, axis, v, u) * (a - p * a_z) / (z + 1e-7)
        };
        along(0) + along(1)
    });
    close_to_scale("depth", by_depth.data(), golden.numbers("grad_border_ac1.depth"), 1e-10);
}

/// clamp((1 - SSIM)/2, 0, 1) from box means of side `k`.
fn dissimilarity<'t>(x: Var<'t, f64>, y: Var<'t, f64>, k: usize) -> Var<'t, f64> {
    let (c1, c2) = (0.01_f64.powi(2), 0.03_f64.powi(2));
    let (mx, my) = (x.box_mean(k), y.box_mean(k));
    let var_x = x.square().box_mean(k).sub(mx.square());
    let var_y = y.square().box_mean(k).sub(my.square());
    let covariance = x.mul(y).box_mean(k).sub(mx.mul(my));
    let upper = mx.mul(my).scale(2.0).add_scalar(c1).mul(covariance.scale(2.0).add_scalar(c2));
    let lower = mx.square().add(my.square()).add_scalar(c1).mul(var_x.add(var_y).add_scalar(c2));
    upper.div(lower).neg().add_scalar(1.0).scale(0.5).clamp(0.0, 1.0)
}

#[test]
fn structural_dissimilarity_from_box_means_matches() {
    let golden = open("ssim");
    for k in [3, 7] {
        let tape = Tape::new();
        let (x, y) = (tape.leaf(golden.map("in.x")), tape.leaf(golden.map("in.y")));
        let map = dissimilarity(x, y, k);
        close_to_scale("dissimilarity", map.value().data(), golden.numbers(&format!("out.dissim{k}")), 1e-9);
        let grads = weighted_gradients(&tape, map, golden.map(&format!("in.w_dissim{k}")));
        close_to_scale("x", grads.wrt(x).data(), golden.numbers(&format!("grad_dissim{k}.x")), 1e-8);
        close_to_scale("y", grads.wrt(y).data(), golden.numbers(&format!("grad_dissim{k}.y")), 1e-8);
    }
}
