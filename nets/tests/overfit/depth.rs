//! Each nano depth network can learn one pair of images by heart.

use dimode_autodiff::{Shape, Tape, Tensor};
use dimode_nets::{Binder, DepthNet, DepthNetKind, Mode, Network, fill};

use crate::adam::Adam;

const SHAPE: Shape = Shape([2, 3, 64, 96]);
const STEPS: u64 = 80;
const RATE: f32 = 3e-3;

/// Inverse depth of a road under a slanted wall, another one for each sample, from 0.2 to 0.9.
fn disparity(n: usize, v: usize, u: usize) -> f32 {
    let (v, u) = (v as f32 / 64.0, u as f32 / 96.0);
    let road = 0.2 + 0.7 * (v - 0.3).max(0.0);
    let wall = 0.35 + 0.25 * (6.0 * u + n as f32).sin();
    road.max(wall)
}

/// Hashed texture whose contrast fades with distance.
fn images() -> Tensor<f32> {
    let texture = |i| fill::unit("texture", i) as f32;
    Tensor::from_fn(SHAPE, |n, c, v, u| {
        let wave = (0.3 * (v as f32) + 0.2 * (u as f32) + c as f32).sin();
        let noise = texture(((n * 3 + c) * 32 + v / 2) * 48 + u / 2);
        0.5 + disparity(n, v, u) * (0.25 * wave + 0.25 * noise)
    })
}

/// Trains on mean squared errors of the finest disparity; losses of all steps.
fn losses(kind: DepthNetKind) -> Vec<f64> {
    let net = DepthNet::new(kind.config());
    let mut params = net.init::<f32>(1);
    let (images, target) = (images(), Tensor::from_fn(Shape::new(2, 1, 64, 96), |n, _, v, u| disparity(n, v, u)));
    let mut adam = Adam::new(RATE);
    let step = |step| {
        let tape = Tape::new();
        let mut binder = Binder::new(&tape, &params, Mode::Train).random(7, step);
        let disparities = net.forward(&mut binder, tape.constant(images.clone()));
        let loss = disparities[0].sub(tape.constant(target.clone())).square().mean();
        let gradients = binder.gradients(&tape.backward(loss));
        let value = f64::from(loss.value().item());
        let statistics = binder.into_statistics();
        adam.step(&mut params, gradients);
        params.apply_statistics(&statistics);
        value
    };
    (0..STEPS).map(step).collect()
}

/// The mean loss of the last ten steps is below a tenth of the first loss.
fn fits(kind: DepthNetKind) {
    let losses = losses(kind);
    let last = losses.iter().rev().take(10).sum::<f64>() / 10.0;
    let reached = losses.iter().position(|&loss| loss < 0.1 * losses[0]);
    println!("{kind}: {:.2e} to {last:.2e} in {STEPS} steps, a tenth after {reached:?}", losses[0]);
    assert!(last < 0.1 * losses[0], "{kind}: {} to {last}", losses[0]);
}

#[test]
fn nano_resnet_fits_one_pair() {
    fits(DepthNetKind::NanoResnet);
}

/// With drop path at its usual rates.
#[test]
fn nano_lite_mono_fits_one_pair() {
    fits(DepthNetKind::NanoLiteMono);
}

#[test]
fn nano_d_hrnet_fits_one_pair() {
    fits(DepthNetKind::NanoDHrNet);
}
