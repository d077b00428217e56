//! Every network that a configuration can name trains together with the others.

use dimode::batch::{Batch, Images};
use dimode::config::{Config, FirstWeights, StageConfig};
use dimode::model::{Model, Weights};
use dimode::optim::adamw::State;
use dimode::trainer::Trainer;
use dimode_autodiff::{Shape, par, rng};
use dimode_geometry::Intrinsics;
use dimode_nets::{DepthNet, DepthNetConfig, DepthNetKind, FlowNetKind, LiteMonoConfig, PoseNetKind};

/// Sides of the images.
const SIDE: usize = 64;

/// The settings of a run with these networks.
fn config(depth: DepthNetKind, pose: PoseNetKind, flow: FlowNetKind) -> Config {
    let mut config = Config::default();
    (config.data.width, config.data.height) = (SIDE, SIDE);
    let nets = &mut config.nets;
    (nets.depth, nets.pose, nets.flow, nets.flow_iterations) = (depth, pose, flow, 2);
    (nets.flow_weights, nets.pose_weights) = (FirstWeights::Random, FirstWeights::Random);
    config
}

/// Two samples of drawn images.
fn batch() -> Batch {
    let image = |seed| rng::uniform::<f32>(seed, Shape::new(2, 3, SIDE, SIDE), 0.0, 1.0);
    let images = Images { target: image(1), previous: image(2), next: image(3) };
    let camera = Intrinsics::new(60.0, 60.0, 31.5, 31.5, SIDE, SIDE).expect("a camera");
    Batch {
        names: vec!["one".into(), "two".into()],
        snippets: vec![(0, 1), (0, 2)],
        flipped: vec![false; 2],
        seen: images.clone(),
        plain: images,
        intrinsics: vec![camera; 2],
        pseudo_depth: None,
    }
}

/// Takes a step with every loss of the paper that needs no pseudo-depth, all three networks trained, and checks that each of them moves.
fn trains(depth: DepthNetKind, pose: PoseNetKind, flow: FlowNetKind) {
    let name = format!("{depth}, {pose}, {flow}");
    let config = config(depth, pose, flow);
    config.validate().unwrap_or_else(|error| panic!("{name}: {error}"));
    let weights = Model::of(&config).init(1);
    let before = weights.clone();
    let mut trainer = Trainer::new(&config, weights, State::default());
    let stage = StageConfig { lambda1: 0.1, lambda2: 0.1, train_flow: true, ..StageConfig::new("all", 1.0) };
    let report = trainer.step(&batch(), None, &stage, 0, 1e-3, false).unwrap_or_else(|error| panic!("{name}: {error}"));
    assert!(report.total.is_finite(), "{name}");
    for (norm, network) in report.network_gradients.into_iter().zip(Weights::NAMES).take(3) {
        assert!(norm.is_some_and(|norm| norm > 0.0), "{name}: no gradient of the {network} network");
    }
    for ((now, before), network) in trainer.weights().sets().into_iter().zip(before.sets()).zip(Weights::NAMES).take(3) {
        let moved = now.trainable().zip(before.trainable()).filter(|(a, b)| a.1.tensor().data() != b.1.tensor().data()).count();
        assert!(2 * moved > now.trainable().count(), "{name}: {moved} tensors of the {network} network moved");
    }
}

#[test]
fn every_triple_of_nano_networks_trains() {
    for depth in [DepthNetKind::NanoResnet, DepthNetKind::NanoLiteMono, DepthNetKind::NanoDHrNet] {
        for pose in [PoseNetKind::Nano, PoseNetKind::NanoScipad] {
            for flow in [FlowNetKind::NanoRaft, FlowNetKind::NanoRaftD4] {
                trains(depth, pose, flow);
            }
        }
    }
}

/// Networks share nothing but images, so each one in some triple is enough for the large ones.
#[test]
fn every_network_of_full_size_trains() {
    use DepthNetKind::{DHrNet, LiteMono, LiteMono8m, LiteMonoSmall, LiteMonoTiny, Resnet18};
    let depths = [Resnet18, LiteMono, LiteMonoSmall, LiteMonoTiny, LiteMono8m, DHrNet];
    let poses = [PoseNetKind::Resnet18, PoseNetKind::Scipad].into_iter().cycle();
    // A period of three, so that each pose network meets each flow network.
    let flows = [FlowNetKind::RaftSmall, FlowNetKind::RaftFull, FlowNetKind::RaftFull].into_iter().cycle();
    for ((depth, pose), flow) in depths.into_iter().zip(poses).zip(flows) {
        trains(depth, pose, flow);
    }
}

/// The weights of a Lite-Mono after one step, with drop path or without, on some threads.
fn depth_after(step: u64, drops: bool, threads: usize) -> Vec<Vec<f32>> {
    let config = config(DepthNetKind::NanoLiteMono, PoseNetKind::Nano, FlowNetKind::NanoRaft);
    let stage = StageConfig::new("all", 1.0);
    par::with_threads(threads, || {
        let mut trainer = Trainer::new(&config, Model::of(&config).init(1), State::default());
        if !drops {
            let sizes = LiteMonoConfig { drop_path: 0.0, ..LiteMonoConfig::nano() };
            trainer.model.depth = DepthNet::new(DepthNetConfig::LiteMono(sizes));
        }
        trainer.step(&batch(), None, &stage, step, 1e-3, false).expect("a finite step");
        trainer.weights().depth.trainable().map(|(_, entry)| entry.tensor().to_vec()).collect()
    })
}

#[test]
fn training_drops_paths_alike_on_any_number_of_threads() {
    let steps = 3..6;
    assert!(steps.clone().any(|step| depth_after(step, true, 1) != depth_after(step, false, 1)), "nothing is dropped");
    for step in steps {
        assert!(depth_after(step, true, 1) == depth_after(step, true, 2), "threads change what is dropped at step {step}");
    }
}

#[test]
fn frames_that_a_network_cannot_take_are_refused_before_the_first_step() {
    let kinds = (DepthNetKind::NanoLiteMono, PoseNetKind::Nano, FlowNetKind::NanoRaft);
    let mut config = config(kinds.0, kinds.1, kinds.2);
    assert!(config.validate().is_ok());
    config.data.width = 80;
    let message = config.validate().unwrap_err().to_string();
    assert!(message.starts_with("nets.depth = nano_lite_mono: ") || message.starts_with("data.width = 80"), "{message}");
}
