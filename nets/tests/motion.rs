//! What pose and flow networks promise beyond parity with recorded numbers.

use dimode_autodiff::{Shape, Tape, Tensor, Var, par};
use dimode_nets::layers::TrainingStatistics;
use dimode_nets::raft::{RaftFull, RaftVariant};
use dimode_nets::{
    Binder, FlowNet, FlowNetConfig, FlowOptions, Mode, Network, PaddingStyle, PoseNet, PoseNetConfig, StatisticsUpdate, fill,
};

/// Hashed texture in [0, 1).
fn image(name: &str, shape: Shape) -> Tensor<f64> {
    Tensor::from_vec(shape, (0..shape.len()).map(|i| 0.5 + 0.5 * fill::unit(name, i)).collect())
}

const SIZE: Shape = Shape([2, 3, 32, 64]);

/// The parts of the full flow network with few channels, filled so that every part has a say.
fn full_flow(statistics: TrainingStatistics) -> FlowNet {
    let full = RaftFull { lookup: 12, mask: 8, statistics };
    FlowNet::new(FlowNetConfig {
        variant: RaftVariant::Full(full),
        stem: 8,
        stages: [8, 10, 12],
        last_stride: 2,
        features: 16,
        hidden: 8,
        context: 6,
        levels: 3,
        radius: 2,
        correlation: 10,
        flow: [8, 6],
        motion: 6,
        head: 8,
        iterations: 3,
    })
}

#[test]
fn batch_norms_of_the_context_encoder_learn_their_statistics_only_where_asked() {
    let (a, b) = (image("a", SIZE), image("b", SIZE));
    let flows = [TrainingStatistics::Running, TrainingStatistics::Batch].map(|statistics| {
        let net = full_flow(statistics);
        let params = net.blueprint().filled(|_| 0.6);
        [Mode::Train, Mode::Eval].map(|mode| {
            let tape = Tape::new();
            let mut binder = Binder::new(&tape, &params, mode);
            let flow = net.forward(&mut binder, tape.constant(a.clone()), tape.constant(b.clone()), 2)[1].value();
            (flow, binder.into_statistics())
        })
    });
    let [[frozen, evaluated], [learning, also_evaluated]] = flows;
    assert!(frozen.1.is_empty() && evaluated.1.is_empty() && also_evaluated.1.is_empty());
    // The stem, twelve convolutions of blocks and two skips.
    let names: Vec<&str> = learning.1.iter().map(|update: &StatisticsUpdate<f64>| update.layer.as_str()).collect();
    assert_eq!(names.len(), 15);
    assert!(names.contains(&"raft:cnet.norm1") && names.contains(&"raft:cnet.layer3.0.norm3"), "{names:?}");
    assert!(names.iter().all(|name| name.starts_with("raft:cnet.")));
    assert_eq!(frozen.0.data(), evaluated.0.data());
    assert_eq!(frozen.0.data(), also_evaluated.0.data());
    assert_ne!(frozen.0.data(), learning.0.data());
}

#[test]
fn the_last_flow_alone_is_the_last_of_all_and_counts_as_much() {
    let net = full_flow(TrainingStatistics::Running);
    let params = net.blueprint().filled::<f64>(|_| 0.6);
    let [all, last] = [false, true].map(|last_only| {
        let tape = Tape::new();
        let mut binder = Binder::frozen(&tape, &params);
        let (a, b) = (tape.constant(image("a", SIZE)), tape.constant(image("b", SIZE)));
        let trace = net.trace(&mut binder, a, b, &FlowOptions { last_only, ..FlowOptions::default() });
        let flows: Vec<_> = trace.flows.iter().map(|flow| flow.value()).collect();
        (flows, binder.macs())
    });
    assert_eq!((all.0.len(), last.0.len()), (3, 1));
    assert_eq!(all.0[2].data(), last.0[0].data());
    assert_eq!(all.1, last.1);
}

#[test]
fn every_parameter_of_the_full_flow_network_learns() {
    let net = full_flow(TrainingStatistics::Running);
    let params = net.blueprint().filled::<f64>(|_| 0.6);
    let tape = Tape::new();
    let mut binder = Binder::new(&tape, &params, Mode::Train);
    let (a, b) = (tape.constant(image("a", SIZE)), tape.constant(image("b", SIZE)));
    let flows = net.forward(&mut binder, a, b, 2);
    let loss = flows[0].square().mean().add(flows[1].square().mean());
    for item in binder.gradients(&tape.backward(loss)) {
        // Instance norm takes a bias before it away.
        let blind = item.path.starts_with("raft:fnet.") && item.path.ends_with(".bias") && item.path != "raft:fnet.conv2.bias";
        assert!(blind || item.gradient.data().iter().any(|&g| g != 0.0), "{} has no gradient", item.path);
    }
}

#[test]
fn frames_of_any_size_have_a_flow_of_their_size() {
    let net = full_flow(TrainingStatistics::Running);
    let params = net.blueprint().filled::<f64>(|_| 0.6);
    let (a, b) = (image("a", SIZE), image("b", SIZE));
    let fitting = net.predict(&params, &a, &b, None);
    for style in [PaddingStyle::Sintel, PaddingStyle::Kitti] {
        assert_eq!(net.predict_any_size(&params, [&a, &b], None, style).data(), fitting.data());
        let odd = Shape::new(1, 3, 37, 51);
        let flow = net.predict_any_size(&params, [&image("a", odd), &image("b", odd)], Some(1), style);
        assert_eq!(flow.shape(), Shape::new(1, 2, 37, 51));
        assert!(flow.data().iter().all(|f| f.is_finite()));
    }
}

#[test]
#[should_panic(expected = "the flow network needs sides that are multiples of 8, at least 32; images of 51x37 do not fit")]
fn the_flow_network_refuses_other_sizes_by_name() {
    let net = full_flow(TrainingStatistics::Running);
    let odd = image("a", Shape::new(1, 3, 37, 51));
    net.predict(&net.init(1), &odd, &odd, None);
}

fn scipad() -> PoseNet {
    PoseNet::new(PoseNetConfig::nano_scipad())
}

fn run<'t>(net: &PoseNet, binder: &mut Binder<'t, f64>, images: [&Tensor<f64>; 2], points: Option<&Tensor<f64>>) -> Var<'t, f64> {
    let [first, second] = images.map(|image| binder.tape().constant(image.clone()));
    let points = points.map(|points| binder.tape().constant(points.clone()));
    let pose = net.forward_with_points(binder, first, second, points);
    Var::concat(&[pose.axis_angle, pose.translation], 1)
}

#[test]
fn scipad_without_points_takes_zeros_and_notices_others() {
    let net = scipad();
    let params = net.blueprint().filled::<f64>(|_| 0.8);
    let (a, b) = (image("a", SIZE), image("b", SIZE));
    let pose = |images, points: Option<&Tensor<f64>>| {
        let tape = Tape::new();
        run(&net, &mut Binder::frozen(&tape, &params), images, points).value()
    };
    let none = pose([&a, &b], None);
    assert_eq!(none.shape(), Shape::new(2, 6, 1, 1));
    assert_eq!(none.data(), pose([&a, &b], Some(&Tensor::zeros(SIZE))).data());
    assert_ne!(none.data(), pose([&a, &b], Some(&image("points", SIZE))).data());
    assert_ne!(none.data(), pose([&b, &a], None).data(), "the order of the images counts");
}

#[test]
fn scipad_in_training_moves_all_running_statistics_as_often_as_its_layers_run() {
    let net = scipad();
    let mut params = net.init::<f64>(1);
    let tape = Tape::new();
    let mut binder = Binder::new(&tape, &params, Mode::Train);
    let pose = run(&net, &mut binder, [&image("a", SIZE), &image("b", SIZE)], None);
    let gradients = binder.gradients(&tape.backward(pose.square().sum()));
    assert_eq!(gradients.len(), params.trainable().count());
    assert!(gradients.iter().all(|item| !item.path.contains("frozen_feature_extractor")));
    let statistics = binder.into_statistics();
    let count = |layer: &str| statistics.iter().filter(|update| update.layer == format!("posenet:{layer}")).count();
    assert_eq!(count("sem_feature_extractor.layer0.1"), 1);
    assert_eq!(count("frozen_feature_extractor.layer0.1"), 2);
    assert_eq!(count("frozen_feature_extractor.layer4.0.downsample.1"), 2);
    assert_eq!(count("pca.pos_embed.2"), 6);
    assert_eq!(count("pca.pc_embed.2"), 3);
    params.apply_statistics(&statistics);
}

#[test]
fn no_gradient_reaches_the_images_through_the_frozen_part() {
    let net = scipad();
    let mut params = net.blueprint().filled::<f64>(|_| 0.8);
    // Without its first convolution the semantic part is blind.
    let path = "posenet:sem_feature_extractor.layer0.0.weight";
    let blind = Tensor::zeros(params.get(path).unwrap().tensor().shape());
    params.set(path, blind);
    let tape = Tape::new();
    let mut binder = Binder::new(&tape, &params, Mode::Train);
    let [first, second] = ["a", "b"].map(|name| tape.leaf(image(name, SIZE)));
    let pose = net.forward(&mut binder, first, second);
    let gradients = tape.backward(pose.axis_angle.sum().add(pose.translation.sum()));
    for image in [first, second] {
        assert!(gradients.wrt(image).data().iter().all(|&g| g == 0.0));
    }
}

#[test]
#[should_panic(
    expected = "the SCIPaD pose network needs sides that are multiples of 32, at least 32; images of 64x48 do not fit"
)]
fn scipad_refuses_other_sizes_by_name() {
    let net = scipad();
    let odd = image("a", Shape::new(1, 3, 48, 64));
    net.predict(&net.init(1), &odd, &odd);
}

/// Bits of outputs and gradients.
fn bits() -> Vec<u64> {
    let mut bits = Vec::new();
    let (a, b) = (image("a", SIZE), image("b", SIZE));
    let tape = Tape::new();
    let (flow, pose) = (full_flow(TrainingStatistics::Batch), scipad());
    let [of_flow, of_pose] = [flow.blueprint().filled(|_| 0.6), pose.blueprint().filled(|_| 0.8)];
    let [mut flow_binder, mut pose_binder] = [&of_flow, &of_pose].map(|params| Binder::new(&tape, params, Mode::Train));
    let motion = run(&pose, &mut pose_binder, [&a, &b], Some(&b));
    let field = flow.forward(&mut flow_binder, tape.constant(a), tape.constant(b), 2)[1];
    let gradients = tape.backward(motion.square().sum().add(field.square().mean()));
    let mut note = |tensor: &Tensor<f64>| bits.extend(tensor.data().iter().map(|v| v.to_bits()));
    for value in [motion, field] {
        note(&value.value());
    }
    for binder in [flow_binder, pose_binder] {
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
