//! A drawn scene: road-like depth, small motion, a rigid flow with some error, colours of realistic contrast.
//!
//! The same construction as `peers/scene.py` with other random numbers. White noise would not do in its place: neighbouring
//! pixels would be warped to places far from each other, and no window would have structure.

use dimode_autodiff::rng::{splitmix64, uniform_at};
use dimode_autodiff::{Shape, Tape, Tensor};
use dimode_geometry::taped::{rigid_flow, so3_exp};

use crate::camera::camera;
use crate::inputs::Inputs;

/// Translations to the previous and to the next image, in the unit of depth.
const TOWARDS: [[f32; 3]; 2] = [[0.25, 0.08, 0.5], [-0.22, -0.07, -0.45]];
/// Spread of rotation vectors around their mean in all three axes, radians.
const ROTATION: [f32; 2] = [0.01, 1e-3];

/// The part of the scene that has this name, if it is one: images `target`, `previous`, `next`; `depth_t`, `depth_s`; `flow`
/// and `other_flow` of the first source; `mask`; `rotation` and `translation`, first of all samples to the previous image,
/// then to the next one.
pub fn part(name: &str, shape: Shape) -> Option<Tensor<f32>> {
    let seed = name.bytes().fold(17, |seed: u64, byte| seed.wrapping_mul(31).wrapping_add(u64::from(byte)));
    Some(match name {
        "target" | "previous" | "next" => {
            let (smooth, rough) = (smooth_field(seed, shape, 24), normal(splitmix64(seed, 1), shape));
            zipped(&smooth, &rough, |smooth, rough| (0.5 + 0.2 * smooth + 0.05 * rough).clamp(0.0, 1.0))
        }
        "depth_t" | "depth_s" => mapped(&smooth_field(seed, shape, 8), |x| 8.0 * (0.5 * x).exp()),
        "mask" => mapped(&smooth_field(seed, shape, 12), |x| if x > -0.8 { 1.0 } else { 0.0 }),
        "flow" | "other_flow" => flow(seed, shape),
        "rotation" => rotations(seed, shape.n()),
        "translation" => {
            let noise = normal(seed, shape);
            Tensor::from_fn(shape, |n, c, _, _| TOWARDS[2 * n / shape.n()][c] + 0.02 * noise.at(n, c, 0, 0))
        }
        _ => return None,
    })
}

/// Flow of the first source, pixels: the rigid flow of a slightly different motion, with smooth errors.
fn flow(seed: u64, shape: Shape) -> Tensor<f32> {
    let (n, h, w) = (shape.n(), shape.h(), shape.w());
    let part = |name, shape| part(name, shape).expect("parts of the scene");
    let camera = camera(&Inputs::Drawn, h, w).expect("a drawn camera makes sense");
    let tape = Tape::new();
    let depth = tape.constant(part("depth_t", shape.with_c(1)));
    let translation = tape.constant(part("translation", Shape::new(2 * n, 3, 1, 1))).slice(0, 0, n).scale(1.05);
    let rotation = tape.constant(rotations(splitmix64(seed, 1), n));
    let rigid = rigid_flow(depth, rotation, translation, &vec![camera; n]).slice(1, 0, 2).value();
    zipped(&rigid, &smooth_field(seed, shape, 16), |rigid, error| rigid + 0.3 * error)
}

/// Small rotations `[n, 1, 3, 3]`.
fn rotations(seed: u64, n: usize) -> Tensor<f32> {
    let vectors = mapped(&normal(seed, Shape::new(n, 3, 1, 1)), |x| ROTATION[0] * x + ROTATION[1]);
    let tape = Tape::new();
    so3_exp(tape.constant(vectors)).value()
}

/// Normally distributed numbers on a grid of `cells` rows and twice as many columns, interpolated.
fn smooth_field(seed: u64, shape: Shape, cells: usize) -> Tensor<f32> {
    let tape = Tape::new();
    tape.constant(normal(seed, shape.with_plane(cells, 2 * cells))).resize_bilinear(shape.h(), shape.w(), true).value()
}

/// Normally distributed numbers of variance 1, by Box and Muller.
fn normal(seed: u64, shape: Shape) -> Tensor<f32> {
    let number = |i: usize| {
        let [radius, angle] = [0, 1].map(|k| uniform_at::<f64>(seed, 2 * i as u64 + k, 0.0, 1.0));
        ((-2.0 * (1.0 - radius).ln()).sqrt() * (std::f64::consts::TAU * angle).cos()) as f32
    };
    Tensor::from_vec(shape, (0..shape.len()).map(number).collect())
}

fn mapped(x: &Tensor<f32>, f: impl Fn(f32) -> f32) -> Tensor<f32> {
    Tensor::from_vec(x.shape(), x.data().iter().map(|&x| f(x)).collect())
}

fn zipped(x: &Tensor<f32>, y: &Tensor<f32>, f: impl Fn(f32, f32) -> f32) -> Tensor<f32> {
    Tensor::from_vec(x.shape(), x.data().iter().zip(y.data()).map(|(&x, &y)| f(x, y)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(name: &str, shape: [usize; 4]) -> Tensor<f32> {
        part(name, Shape(shape)).expect("a part of the scene")
    }

    fn mean(x: &[f32], f: impl Fn(f32) -> f32) -> f32 {
        x.iter().map(|&x| f(x)).sum::<f32>() / x.len() as f32
    }

    #[test]
    fn normal_numbers_have_mean_0_and_variance_1() {
        let x = normal(3, Shape::new(1, 1, 100, 100));
        assert!(mean(x.data(), |x| x).abs() < 0.04 && (mean(x.data(), |x| x * x) - 1.0).abs() < 0.05);
    }

    #[test]
    fn images_and_depths_have_structure() {
        let (n, h, w) = (2, 64, 128);
        let (image, depth) = (of("target", [n, 3, h, w]), of("depth_t", [n, 1, h, w]));
        assert!(image.data().iter().all(|x| (0.0..=1.0).contains(x)) && depth.data().iter().all(|&z| z > 0.5 && z < 100.0));
        for x in [&image, &depth] {
            // Neighbours differ less than pixels far apart, where white noise differs as much.
            let (x, far) = (x.plane(0, 0), h / 3 * w + w / 3);
            let squares = |apart: usize| x.iter().zip(&x[apart..]).take(h * w / 2).map(|(a, b)| (a - b).powi(2)).sum::<f32>();
            assert!(2.0 * squares(1) < squares(far), "{} against {}", squares(1), squares(far));
        }
        assert!(of("next", [n, 3, h, w]).data() != image.data());
    }

    #[test]
    fn motions_are_small_and_flows_follow_them() {
        let (n, h, w) = (2, 64, 128);
        let (rotation, translation) = (of("rotation", [2 * n, 1, 3, 3]), of("translation", [2 * n, 3, 1, 1]));
        for i in 0..2 * n {
            assert!((0..3).all(|k| (rotation.at(i, 0, k, k) - 1.0).abs() < 0.01));
            assert_eq!(translation.at(i, 2, 0, 0) > 0.0, i < n, "the previous image first");
        }
        let (flow, other) = (of("flow", [n, 2, h, w]), of("other_flow", [n, 2, h, w]));
        let long = mean(flow.data(), f32::abs);
        assert!((0.5..20.0).contains(&long), "{long}");
        let apart = mean(zipped(&flow, &other, |x, y| x - y).data(), f32::abs);
        assert!(apart > 0.0 && apart < 0.7 * long, "{apart} of {long}");
        let seen = mean(of("mask", [n, 1, h, w]).data(), |x| x);
        assert!((0.5..0.95).contains(&seen), "{seen}");
    }
}
