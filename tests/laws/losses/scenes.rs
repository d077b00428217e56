//! Cameras, motions and rendered planes.

use dimode_autodiff::gradcheck::random;
use dimode_autodiff::{Shape, Tape, Tensor};
use dimode_geometry::taped::pose::pose_tensors;
use dimode_geometry::taped::rigid_flow;
use dimode_geometry::{Intrinsics, Se3, so3};
use nalgebra::Vector3;

pub const H: usize = 6;
pub const W: usize = 8;

/// One channel of `n` samples.
pub fn maps(n: usize) -> Shape {
    Shape::new(n, 1, H, W)
}

/// Cameras of three samples; the principal point of the first is a pixel.
pub fn cameras() -> Vec<Intrinsics> {
    [[14.0, 15.0, 4.0, 3.0], [13.0, 12.0, 3.3, 2.6], [16.0, 15.5, 4.4, 2.2]]
        .map(|[fu, fv, u0, v0]| Intrinsics::new(fu, fv, u0, v0, W, H).unwrap())
        .to_vec()
}

pub fn motion(w: [f64; 3], t: [f64; 3]) -> Se3 {
    Se3::from_rotation_vector(&w.into(), t.into())
}

/// General motions of three samples whose radial translations have the given sign.
pub fn motions(sign: f64) -> Vec<Se3> {
    vec![
        motion([0.02, -0.04, 0.03], [0.35, -0.25, 0.5 * sign]),
        motion([-0.03, 0.02, 0.01], [-0.3, 0.4, 0.45 * sign]),
        motion([0.01, 0.03, -0.02], [0.28, 0.31, 0.6 * sign]),
    ]
}

/// Rotation vectors (N,3,1,1) and translations (N,3,1,1).
pub fn vectors(motions: &[Se3]) -> [Tensor<f64>; 2] {
    let shape = Shape::new(motions.len(), 3, 1, 1);
    let turns: Vec<Vector3<f64>> = motions.iter().map(|m| so3::log(&m.rotation)).collect();
    [Tensor::from_fn(shape, |n, i, _, _| turns[n][i]), Tensor::from_fn(shape, |n, i, _, _| motions[n].translation[i])]
}

/// Flow and source depth of a static scene.
pub fn seen(depth: &Tensor<f64>, motions: &[Se3], cameras: &[Intrinsics]) -> [Tensor<f64>; 2] {
    let tape = Tape::new();
    let (r, t) = pose_tensors(motions);
    let rigid = rigid_flow(tape.constant(depth.clone()), tape.constant(r), tape.constant(t), cameras);
    [rigid.slice(1, 0, 2).value(), rigid.slice(1, 2, 1).value()]
}

/// Depth of the planes `normal . X = distance`, X in the target frame.
pub fn plane(normals: &[Vector3<f64>], distances: &[f64], cameras: &[Intrinsics]) -> Tensor<f64> {
    let k = &cameras[0];
    let shape = Shape::new(cameras.len(), 1, k.height, k.width);
    Tensor::from_fn(shape, |n, _, v, u| distances[n] / normals[n].dot(&cameras[n].ray(u as f64, v as f64)))
}

/// Target depth of planes that face the source at `distance`: every source depth is that number, so reading it between pixels
/// is exact.
pub fn facing_the_source(distance: f64, motions: &[Se3], cameras: &[Intrinsics]) -> Tensor<f64> {
    // (R X + t)_z = distance.
    let normals: Vec<_> = motions.iter().map(|m| m.rotation.row(2).transpose()).collect();
    let distances: Vec<_> = motions.iter().map(|m| distance - m.translation.z).collect();
    plane(&normals, &distances, cameras)
}

/// Every entry times a random factor of `1 - size` to `1 + size`.
pub fn bent(x: &Tensor<f64>, seed: u64, size: f64) -> Tensor<f64> {
    let factors = random::<f64>(seed, x.shape(), 1.0 - size, 1.0 + size);
    Tensor::from_vec(x.shape(), x.data().iter().zip(factors.data()).map(|(x, f)| x * f).collect())
}

/// Every entry plus a random number of `-size` to `size`.
pub fn shifted(x: &Tensor<f64>, seed: u64, size: f64) -> Tensor<f64> {
    let steps = random::<f64>(seed, x.shape(), -size, size);
    Tensor::from_vec(x.shape(), x.data().iter().zip(steps.data()).map(|(x, f)| x + f).collect())
}

/// Flows whose ends lie at least 0.15 px from the lines between pixel centres, where reading has its kinks, and from the border.
pub fn between_pixels(flow: &Tensor<f64>) -> Tensor<f64> {
    Tensor::from_fn(flow.shape(), |n, c, h, w| {
        let (at, f) = ([w, h][c] as f64, flow.at(n, c, h, w));
        let cell = (at + f).floor();
        cell + 0.15 + 0.7 * (at + f - cell) - at
    })
}

/// A one-channel mask of `n` samples.
pub fn mask(n: usize, keep: impl Fn(usize, usize, usize) -> bool) -> Tensor<f64> {
    Tensor::from_fn(maps(n), |n, _, h, w| f64::from(u8::from(keep(n, h, w))))
}

/// Smooth images in (0, 1), three channels, with some noise.
pub fn images(n: usize, seed: u64) -> Tensor<f64> {
    let base = Tensor::from_fn(maps(n).with_c(3), |n, c, h, w| {
        0.5 + 0.3 * ((0.7 * w as f64 + 0.4 * c as f64 + n as f64).sin() * (0.5 * h as f64 + seed as f64).cos())
    });
    shifted(&base, seed, 0.1)
}
