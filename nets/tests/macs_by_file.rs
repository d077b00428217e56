//! Multiply-accumulates of depth and pose networks, divided by checkpoint file as in published tables.

use dimode_autodiff::{Shape, Tape, Tensor};
use dimode_nets::{Binder, DepthNet, DepthNetKind, Network, PoseNet, PoseNetKind};

/// Of each checkpoint file, for images of width x height.
fn counted(network: &impl Network, (width, height): (usize, usize), forward: impl Fn(&mut Binder<f32>, Tensor<f32>)) -> Vec<u64> {
    let params = network.init::<f32>(1);
    let tape = Tape::new();
    let mut binder = Binder::frozen(&tape, &params);
    forward(&mut binder, Tensor::full(Shape::new(1, 3, height, width), 0.5));
    binder.macs_by_file()
}

fn depth(kind: DepthNetKind, size: (usize, usize)) -> Vec<u64> {
    let net = DepthNet::new(kind.config());
    counted(&net, size, |binder, image| {
        net.forward(binder, binder.tape().constant(image));
    })
}

fn pose(kind: PoseNetKind, size: (usize, usize)) -> Vec<u64> {
    let net = PoseNet::new(kind.config());
    counted(&net, size, |binder, image| {
        let image = binder.tape().constant(image);
        net.forward(binder, image, image);
    })
}

#[test]
fn encoders_and_decoders_of_the_reference_share_the_work_as_published() {
    let billions = |files: Vec<u64>| files.iter().map(|&macs| format!("{:.3}", macs as f64 / 1e9)).collect::<Vec<_>>();
    assert_eq!(billions(depth(DepthNetKind::Resnet18, (640, 192))), ["4.441", "3.572"]);
    assert_eq!(billions(pose(PoseNetKind::Resnet18, (640, 192))), ["4.730", "0.158"]);
}

#[test]
fn the_files_of_a_network_add_up() {
    for (size, expected) in [((96, 64), "13.19"), ((192, 64), "26.39")] {
        let files = depth(DepthNetKind::NanoResnet, size);
        assert!(files.len() == 2 && files.iter().all(|&macs| macs > 1_000_000), "{files:?}");
        assert_eq!(format!("{:.2}", files.iter().sum::<u64>() as f64 / 1e6), expected);
    }
}
