//! Networks at work without gradients, over buffers that stay from image to image.

use std::sync::Arc;

use dimode_autodiff::{Pool, Tape, Tensor};
use dimode_nets::{Binder, DepthNet, FlowNet, FlowOptions, ParamSet, PoseNet};

/// Buffers that stay.
pub type Buffers = Arc<Pool<f32>>;

/// Disparity `[n, 1, h, w]` in (0, 1) of images `[n, 3, h, w]`.
///
/// # Panics
/// When the network does not take the size.
pub fn disparity(net: &DepthNet, weights: &ParamSet<f32>, images: &Tensor<f32>, buffers: &Buffers) -> Tensor<f32> {
    let tape = Tape::with_pool(buffers.clone());
    let mut binder = Binder::frozen(&tape, weights);
    net.forward(&mut binder, tape.constant(images.clone()))[0].value()
}

/// Rotation vectors and translations, each `[n, 3, 1, 1]`, between images `[n, 3, h, w]`, as the network says them.
///
/// # Panics
/// When the network does not take the size.
pub fn pose(net: &PoseNet, weights: &ParamSet<f32>, images: [&Tensor<f32>; 2], buffers: &Buffers) -> [Tensor<f32>; 2] {
    let tape = Tape::with_pool(buffers.clone());
    let mut binder = Binder::frozen(&tape, weights);
    let [first, second] = images.map(|images| tape.constant(images.clone()));
    let said = net.forward(&mut binder, first, second);
    [said.axis_angle.value(), said.translation.value()]
}

/// Flow `[n, 2, h, w]` in pixels from the first to the second images `[n, 3, h, w]`.
///
/// # Panics
/// When the network does not take the size, or without any iteration.
pub fn flow(
    net: &FlowNet,
    weights: &ParamSet<f32>,
    images: [&Tensor<f32>; 2],
    iterations: usize,
    buffers: &Buffers,
) -> Tensor<f32> {
    let tape = Tape::with_pool(buffers.clone());
    let mut binder = Binder::frozen(&tape, weights);
    let [first, second] = images.map(|images| tape.constant(images.clone()));
    let options = FlowOptions { iterations: Some(iterations), last_only: true, ..FlowOptions::default() };
    net.trace(&mut binder, first, second, &options).flows[0].value()
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::Shape;
    use dimode_autodiff::gradcheck::random;
    use dimode_nets::{DepthNetKind, FlowNetKind, Network, PoseNetKind};

    #[test]
    fn buffers_that_were_used_before_change_nothing() {
        let [first, second] = [1, 2].map(|seed| random::<f32>(seed, Shape::new(1, 3, 64, 96), 0.0, 1.0));
        let depth = DepthNet::new(DepthNetKind::NanoResnet.config());
        let motion = PoseNet::new(PoseNetKind::Nano.config());
        let optical = FlowNet::new(FlowNetKind::NanoRaft.config());
        let (depth_weights, pose_weights, flow_weights) = (depth.init(1), motion.init(2), optical.init(3));
        let buffers = Pool::new();
        for _ in 0..2 {
            let said = disparity(&depth, &depth_weights, &first, &buffers);
            assert_eq!(said.data(), depth.predict(&depth_weights, &first).data());
            let [rotation, translation] = pose(&motion, &pose_weights, [&first, &second], &buffers);
            let expected = motion.predict(&pose_weights, &first, &second);
            assert_eq!((rotation.data(), translation.data()), (expected.0.data(), expected.1.data()));
            let flow = flow(&optical, &flow_weights, [&first, &second], 2, &buffers);
            assert_eq!(flow.data(), optical.predict(&flow_weights, &first, &second, Some(2)).data());
        }
        assert!(buffers.peak_bytes() > 0);
    }
}
