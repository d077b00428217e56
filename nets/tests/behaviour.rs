//! What the networks promise beyond parity with recorded numbers.

use dimode_autodiff::{Shape, Tape, Tensor, par};
use dimode_nets::{
    Binder, DepthNet, DepthNetConfig, FlowNet, FlowNetConfig, FlowOptions, ImageRange, Mode, Network, ParamGradient, ParamSet,
    PoseNet, PoseNetConfig, RectifyNet, RectifyNetConfig, fill, weights,
};

const SIZE: Shape = Shape([1, 3, 64, 96]);

/// Hashed texture in [0, 1).
fn image(name: &str, batch: usize) -> Tensor<f32> {
    let shape = Shape::new(batch, SIZE.c(), SIZE.h(), SIZE.w());
    let value = |i| (0.5 + 0.5 * fill::unit(name, i)) as f32;
    Tensor::from_vec(shape, (0..shape.len()).map(value).collect())
}

fn stacked(images: &[&Tensor<f32>]) -> Tensor<f32> {
    let data: Vec<f32> = images.iter().flat_map(|t| t.to_vec()).collect();
    let shape = Shape::new(images.len(), SIZE.c(), SIZE.h(), SIZE.w());
    Tensor::from_vec(shape, data)
}

fn assert_near(a: &[f32], b: &[f32], tolerance: f32) {
    assert_eq!(a.len(), b.len());
    for (i, (a, b)) in a.iter().zip(b).enumerate() {
        assert!((a - b).abs() <= tolerance, "element {i}: {a} against {b}");
    }
}

#[test]
fn fresh_depth_is_sane_and_every_scale_has_its_size() {
    let net = DepthNet::new(DepthNetConfig::nano());
    let params = net.init::<f32>(1);
    let tape = Tape::new();
    let mut binder = Binder::new(&tape, &params, Mode::Train);
    let disparities = net.forward(&mut binder, tape.constant(image("a", 2)));
    for (scale, disparity) in disparities.iter().enumerate() {
        let expected = Shape::new(2, 1, 64 >> scale, 96 >> scale);
        assert_eq!(disparity.shape(), expected);
        let value = disparity.value();
        assert!(value.data().iter().all(|&d| d > 0.0 && d < 1.0));
    }
}

#[test]
fn depth_of_a_batch_is_that_of_its_images() {
    let net = DepthNet::new(DepthNetConfig::nano());
    let params = net.init::<f32>(1);
    let (a, b) = (image("a", 1), image("b", 1));
    let both = net.predict(&params, &stacked(&[&a, &b]));
    let (a, b) = (net.predict(&params, &a), net.predict(&params, &b));
    assert_near(both.plane(0, 0), a.data(), 1e-6);
    assert_near(both.plane(1, 0), b.data(), 1e-6);
}

#[test]
fn a_frozen_network_passes_gradients_to_its_input_only() {
    let net = DepthNet::new(DepthNetConfig::nano());
    let params = net.init::<f32>(1);
    let tape = Tape::new();
    let mut binder = Binder::frozen(&tape, &params);
    let input = tape.leaf(image("a", 1));
    let loss = net.forward(&mut binder, input)[0].mean();
    let gradients = tape.backward(loss);
    assert!(gradients.wrt(input).data().iter().any(|&g| g != 0.0));
    let of_params = binder.gradients(&gradients);
    assert_eq!(of_params.len(), params.trainable().count());
    let zero = |t: &Tensor<f32>| t.data().iter().all(|&g| g == 0.0);
    assert!(of_params.iter().all(|g| zero(&g.gradient)));
    assert!(binder.into_statistics().is_empty());
}

#[test]
fn every_parameter_of_a_nano_network_learns() {
    let depth = DepthNet::new(DepthNetConfig::nano());
    let params = depth.init::<f32>(1);
    let tape = Tape::new();
    let mut binder = Binder::new(&tape, &params, Mode::Train);
    let disparities = depth.forward(&mut binder, tape.constant(image("a", 2)));
    let losses = disparities.iter().map(|d| d.square().mean());
    let loss = losses.reduce(|a, b| a.add(b)).unwrap();
    let gradients = binder.gradients(&tape.backward(loss));
    assert_all_move(&gradients);
}

fn assert_all_move(gradients: &[ParamGradient<f32>]) {
    for item in gradients {
        let moves = item.gradient.data().iter().any(|&g| g != 0.0);
        assert!(moves, "{} has no gradient", item.path);
    }
}

#[test]
fn every_parameter_of_the_nano_rectifying_network_learns() {
    let net = RectifyNet::new(RectifyNetConfig::nano());
    let params = net.init::<f32>(1);
    let tape = Tape::new();
    let mut binder = Binder::new(&tape, &params, Mode::Train);
    let angles = net.forward(&mut binder, tape.constant(image("a", 2)), tape.constant(image("b", 2)));
    assert_eq!(angles.shape(), Shape::new(2, 3, 1, 1));
    assert_all_move(&binder.gradients(&tape.backward(angles.square().sum())));
}

#[test]
fn two_passes_in_training_move_the_running_statistics_twice() {
    let net = PoseNet::new(PoseNetConfig::nano());
    let mut params = net.init::<f32>(1);
    let tape = Tape::new();
    let mut binder = Binder::new(&tape, &params, Mode::Train);
    let (a, b) = (tape.constant(image("a", 2)), tape.constant(image("b", 2)));
    net.forward(&mut binder, a, b);
    let once = binder.statistics().len();
    let pose = net.forward(&mut binder, b, a);
    assert_eq!(pose.axis_angle.shape(), Shape::new(2, 3, 1, 1));
    assert_eq!(pose.translation.shape(), Shape::new(2, 3, 1, 1));
    let statistics = binder.into_statistics();
    assert_eq!(statistics.len(), 2 * once);
    let path = "pose_encoder:encoder.bn1.running_var";
    let before = params.get(path).unwrap().tensor().to_vec();
    params.apply_statistics(&statistics);
    let after = params.get(path).unwrap().tensor().to_vec();
    let of = |i: usize| statistics[i].variance.to_vec();
    for (c, &value) in after.iter().enumerate() {
        let (first, second) = (of(0)[c], of(once)[c]);
        let expected = 0.9 * (0.9 * before[c] + 0.1 * first) + 0.1 * second;
        assert!((value - expected).abs() < 1e-5 * expected.abs().max(1.0));
    }
}

#[test]
fn pose_depends_on_the_order_of_the_images() {
    let net = PoseNet::new(PoseNetConfig::nano());
    let params = net.init::<f32>(1);
    let (a, b) = (image("a", 1), image("b", 1));
    let (forward, _) = net.predict(&params, &a, &b);
    let (backward, _) = net.predict(&params, &b, &a);
    assert_ne!(forward.data(), backward.data());
    assert!(forward.data().iter().all(|v| v.abs() < 0.1));
}

fn flow() -> (FlowNet, ParamSet<f32>) {
    let net = FlowNet::new(FlowNetConfig::nano_raft());
    let params = net.blueprint().filled(|_| 0.6);
    (net, params)
}

#[test]
fn flow_takes_either_range_of_pixel_values() {
    let (net, params) = flow();
    let tape = Tape::new();
    let mut binder = Binder::frozen(&tape, &params);
    let (a, b) = (tape.constant(image("a", 1)), tape.constant(image("b", 1)));
    let unit = net.forward(&mut binder, a, b, 2)[1].value();
    let options = FlowOptions { iterations: Some(2), range: ImageRange::Byte, last_only: true };
    let trace = net.trace(&mut binder, a.scale(255.0), b.scale(255.0), &options);
    assert_eq!(trace.flows.len(), 1);
    let byte = trace.flows[0].value();
    let largest = unit.data().iter().fold(0f32, |m, v| m.max(v.abs()));
    assert!(largest > 0.1, "flow is not trivial");
    assert_near(unit.data(), byte.data(), 1e-3 * largest);
    let predicted = net.predict(&params, &image("a", 1), &image("b", 1), Some(2));
    assert_eq!(predicted.data(), unit.data());
}

#[test]
fn flow_of_a_batch_is_that_of_its_pairs() {
    let (net, params) = flow();
    let (a, b) = (image("a", 1), image("b", 1));
    let both = net.predict(&params, &stacked(&[&a, &b]), &stacked(&[&b, &a]), Some(2));
    let (ab, ba) = (net.predict(&params, &a, &b, Some(2)), net.predict(&params, &b, &a, Some(2)));
    let largest = both.data().iter().fold(0f32, |m, v| m.max(v.abs()));
    let half = ab.data().len();
    assert_near(&both.data()[..half], ab.data(), 1e-3 * largest);
    assert_near(&both.data()[half..], ba.data(), 1e-3 * largest);
}

/// Bits of outputs and gradients of all four nano networks.
fn bits() -> Vec<u32> {
    let mut bits = Vec::new();
    let mut note = |tensor: &Tensor<f32>| bits.extend(tensor.data().iter().map(|v| v.to_bits()));
    let tape = Tape::new();
    let (a, b) = (tape.constant(image("a", 2)), tape.constant(image("b", 2)));
    let depth = DepthNet::new(DepthNetConfig::nano());
    let params = depth.init::<f32>(1);
    let mut depth_binder = Binder::new(&tape, &params, Mode::Train);
    let disparity = depth.forward(&mut depth_binder, a)[0];
    let pose = PoseNet::new(PoseNetConfig::nano());
    let params = pose.init::<f32>(1);
    let mut pose_binder = Binder::new(&tape, &params, Mode::Train);
    let motion = pose.forward(&mut pose_binder, a, b);
    let rectify = RectifyNet::new(RectifyNetConfig::nano());
    let params = rectify.init::<f32>(1);
    let mut rectify_binder = Binder::new(&tape, &params, Mode::Train);
    let angles = rectify.forward(&mut rectify_binder, a, b);
    let (flow, params) = flow();
    let mut flow_binder = Binder::new(&tape, &params, Mode::Train);
    let field = flow.forward(&mut flow_binder, a, b, 2)[1];
    note(&disparity.value());
    note(&field.value());
    note(&angles.value());
    let loss = disparity.mean().add(field.square().mean()).add(angles.square().mean());
    let loss = loss.add(motion.axis_angle.add(motion.translation).sum());
    let gradients = tape.backward(loss);
    for binder in [depth_binder, pose_binder, flow_binder, rectify_binder] {
        for item in binder.gradients(&gradients) {
            note(&item.gradient);
        }
    }
    bits
}

#[test]
fn the_number_of_threads_does_not_change_a_bit() {
    let one = par::with_threads(1, bits);
    let three = par::with_threads(3, bits);
    assert!(one == three, "results differ between 1 and 3 threads");
}

#[test]
fn saved_weights_give_the_same_prediction() {
    let net = DepthNet::new(DepthNetConfig::nano());
    let saved = net.init::<f32>(1);
    let directory = std::env::temp_dir().join(format!("dimode-nets-{}", std::process::id()));
    weights::save_directory(&directory, &saved).unwrap();
    let mut loaded = net.init::<f32>(2);
    weights::load_directory(&directory, &mut loaded).unwrap();
    std::fs::remove_dir_all(&directory).unwrap();
    let image = image("a", 1);
    let (a, b) = (net.predict(&saved, &image), net.predict(&loaded, &image));
    assert_eq!(a.data(), b.data());
}

#[test]
#[should_panic(expected = "multiples of 32")]
fn odd_sizes_are_refused_by_name() {
    let net = DepthNet::new(DepthNetConfig::nano());
    let params = net.init::<f32>(1);
    net.predict(&params, &Tensor::full(Shape::new(1, 3, 60, 96), 0.5));
}
