//! Warping and box means against reference values and gradients computed by PyTorch in double precision.

use dimode_autodiff::ops::bilinear_sample::SamplePadding;
use dimode_autodiff::{Gradients, Shape, Tape, Tensor, Var};
use safetensors::SafeTensors;

/// The tensors of one golden file.
struct Golden(Vec<u8>);

impl Golden {
    fn open(name: &str) -> Self {
        let path = format!(concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/golden/losses/{}"), name);
        Golden(std::fs::read(&path).unwrap_or_else(|error| panic!("{path}: {error}")))
    }

    fn values(&self, name: &str) -> Vec<f64> {
        let file = SafeTensors::deserialize(&self.0).expect("a well-formed file");
        let data = file.tensor(name).unwrap_or_else(|_| panic!("the file has {name}")).data().to_vec();
        data.chunks_exact(8).map(|b| f64::from_le_bytes(b.try_into().expect("eight bytes"))).collect()
    }

    fn tensor(&self, name: &str, shape: [usize; 4]) -> Tensor<f64> {
        Tensor::from_vec(Shape(shape), self.values(name))
    }
}

#[track_caller]
fn assert_close(got: &[f64], expected: &[f64], tolerance: f64) {
    assert_eq!(got.len(), expected.len());
    let scale = expected.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    assert!(scale > 100.0 * tolerance, "nothing to compare: largest value {scale}");
    for (i, (g, e)) in got.iter().zip(expected).enumerate() {
        assert!((g - e).abs() <= tolerance * scale.max(1.0), "element {i}: {g} instead of {e}");
    }
}

const IMAGE: [usize; 4] = [2, 3, 24, 32];
const COORDS: [usize; 4] = [2, 2, 24, 32];

fn warp<'t>(tape: &'t Tape<f64>, golden: &Golden, padding: SamplePadding) -> [Var<'t, f64>; 3] {
    let image = tape.leaf(golden.tensor("in.image", IMAGE));
    let coords = tape.leaf(golden.tensor("out.pix", COORDS));
    [image, coords, image.bilinear_sample(coords, padding)]
}

#[test]
fn warped_images_match_with_either_padding() {
    let golden = Golden::open("warp.f64.safetensors");
    let tape = Tape::new();
    for (padding, name) in [(SamplePadding::Border, "out.warped_border_ac1"), (SamplePadding::Zeros, "out.warped_zeros_ac1")] {
        let [_, _, warped] = warp(&tape, &golden, padding);
        assert_close(warped.value().data(), &golden.values(name), 1e-12);
    }
}

fn weighted_gradients(tape: &Tape<f64>, warped: Var<'_, f64>, weights: Tensor<f64>) -> Gradients<f64> {
    let shape = warped.shape();
    assert_eq!(shape, weights.shape());
    tape.backward(warped.mul(warped.tape().constant(weights)).sum())
}

#[test]
fn the_image_gradient_matches() {
    let golden = Golden::open("warp.f64.safetensors");
    let tape = Tape::new();
    let [image, _, warped] = warp(&tape, &golden, SamplePadding::Border);
    let grads = weighted_gradients(&tape, warped, golden.tensor("in.w", IMAGE));
    assert_close(grads.wrt(image).data(), &golden.values("grad_border_ac1.image"), 1e-12);
}

/// The coordinates depend on the depth as pix = (D a + b)_xy / ((D a + b)_z + 1e-7) with b = K t, so with
/// y = pix (y_z + 1e-7) the derivative of pix by D is (a_xy - pix a_z) / (y_z + 1e-7), where D a = y - b.
#[test]
fn the_coordinate_gradient_matches_through_the_depth() {
    let golden = Golden::open("warp.f64.safetensors");
    let tape = Tape::new();
    let [_, coords, warped] = warp(&tape, &golden, SamplePadding::Border);
    let by_coords = weighted_gradients(&tape, warped, golden.tensor("in.w", IMAGE)).wrt(coords);
    let plane = [2, 1, 24, 32];
    let (pix, depth) = (golden.tensor("out.pix", COORDS), golden.tensor("in.depth", plane));
    let third = golden.tensor("out.computed_depth", plane);
    let (k, t) = (golden.tensor("in.K", [2, 1, 3, 3]), golden.tensor("in.translation", [2, 3, 1, 1]));
    let by_depth = Tensor::from_fn(Shape(plane), |n, _, v, u| {
        let b = |row| (0..3).map(|j| k.at(n, 0, row, j) * t.at(n, j, 0, 0)).sum::<f64>();
        let (d, z) = (depth.at(n, 0, v, u), third.at(n, 0, v, u));
        let along = |axis: usize| {
            let p = pix.at(n, axis, v, u);
            let (a, a_z) = ((p * (z + 1e-7) - b(axis)) / d, (z - b(2)) / d);
            by_coords.at(n, axis, v, u) * (a - p * a_z) / (z + 1e-7)
        };
        along(0) + along(1)
    });
    assert_close(by_depth.data(), &golden.values("grad_border_ac1.depth"), 1e-10);
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
    let golden = Golden::open("ssim.f64.safetensors");
    for k in [3, 7] {
        let tape = Tape::new();
        let (x, y) = (tape.leaf(golden.tensor("in.x", IMAGE)), tape.leaf(golden.tensor("in.y", IMAGE)));
        let map = dissimilarity(x, y, k);
        assert_close(map.value().data(), &golden.values(&format!("out.dissim{k}")), 1e-9);
        let grads = weighted_gradients(&tape, map, golden.tensor(&format!("in.w_dissim{k}"), IMAGE));
        assert_close(grads.wrt(x).data(), &golden.values(&format!("grad_dissim{k}.x")), 1e-8);
        assert_close(grads.wrt(y).data(), &golden.values(&format!("grad_dissim{k}.y")), 1e-8);
    }
}
