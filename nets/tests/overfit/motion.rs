//! Every pose and flow network learns one image pair by heart: the loss falls tenfold in a bounded number of steps.

use dimode_autodiff::{Shape, Tape, Tensor, Var};
use dimode_nets::layers::TrainingStatistics;
use dimode_nets::raft::{RaftFull, RaftVariant};
use dimode_nets::{Binder, FlowNet, FlowNetConfig, FlowNetKind, Kind, Mode, Network, ParamSet, PoseNet, PoseNetKind};

use crate::adam::Adam;

const SIZE: Shape = Shape([1, 3, 64, 96]);
/// Flow in pixels at the middle of the first image, and how it grows: along u by the row, along v by the column.
const SHIFT: [f64; 2] = [3.0, -2.0];
const SHEAR: [f64; 2] = [0.1, 0.05];

/// Displacement of the second image at a pixel of the first one.
fn displacement(u: f64, v: f64) -> [f64; 2] {
    [SHIFT[0] + SHEAR[0] * (v - 32.0), SHIFT[1] + SHEAR[1] * (u - 48.0)]
}

/// Two images: a smooth texture in [0, 1], and the same displaced.
fn pair() -> [Tensor<f32>; 2] {
    let origin = |u: f64, v: f64| {
        // The inverse of the affine map (u, v) + displacement(u, v).
        let (x, y) = (u - SHIFT[0] + SHEAR[0] * 32.0, v - SHIFT[1] + SHEAR[1] * 48.0);
        let determinant = 1.0 - SHEAR[0] * SHEAR[1];
        ((x - SHEAR[0] * y) / determinant, (y - SHEAR[1] * x) / determinant)
    };
    let still = |u, v| (u, v);
    [texture(still), texture(origin)]
}

/// What the texture shows at the places that the pixels come from.
fn texture(origin: impl Fn(f64, f64) -> (f64, f64)) -> Tensor<f32> {
    Tensor::from_fn(SIZE, |_, c, v, u| {
        let (x, y) = origin(u as f64, v as f64);
        let wave = |a: f64, b: f64, phase: f64| (a * x + b * y + phase + c as f64).sin();
        let sum = wave(0.31, 0.12, 0.0) + wave(-0.17, 0.41, 1.0) + wave(0.53, -0.37, 2.0) + wave(0.08, 0.09, 3.0);
        (0.5 + 0.12 * sum) as f32
    })
}

/// The displaced image shows at the end of every displacement what the first one shows at its start.
#[test]
fn the_pair_has_the_flow_that_is_taught() {
    let [first, second] = pair();
    // A pixel whose displacement is whole: 3 + 0.1 (42 - 32) = 4 and -2 + 0.05 (28 - 48) = -3.
    assert_eq!(displacement(28.0, 42.0), [4.0, -3.0]);
    for c in 0..3 {
        assert!((second.at(0, c, 39, 32) - first.at(0, c, 42, 28)).abs() < 1e-6);
    }
}

/// Trains at most `steps` steps, until the loss is a tenth of the first one, and gives the weights before and after.
fn overfit(
    network: &impl Network,
    (rate, steps): (f32, usize),
    loss: impl for<'t> Fn(&mut Binder<'t, f32>) -> Var<'t, f32>,
) -> [ParamSet<f32>; 2] {
    let start = network.init::<f32>(1);
    let (mut params, mut adam, mut first) = (start.clone(), Adam::new(rate), None);
    let mut last = f32::INFINITY;
    for step in 0..steps {
        let tape = Tape::new();
        let mut binder = Binder::new(&tape, &params, Mode::Train);
        let value = loss(&mut binder);
        last = value.value().item();
        let goal = *first.get_or_insert(last) / 10.0;
        assert!(last.is_finite());
        if last < goal {
            println!("loss {:.4} fell to {last:.4} in {step} steps", goal * 10.0);
            return [start, params];
        }
        let gradients = binder.gradients(&tape.backward_and_free(value));
        let statistics = binder.into_statistics();
        drop(tape);
        adam.step(&mut params, gradients);
        params.apply_statistics(&statistics);
    }
    panic!("the loss {:?} is at {last} after {steps} steps", first);
}

/// Hundredths of a radian and hundredths of the unit of length: what the factor of the decoders leaves near one.
const POSE: [f64; 6] = [0.8, -0.5, 0.3, -1.0, 0.4, 1.2];

fn pose(kind: PoseNetKind) -> [ParamSet<f32>; 2] {
    let net = PoseNet::new(kind.config());
    let pair = pair();
    overfit(&net, (1e-3, 40), |binder| {
        let [first, second] = pair.each_ref().map(|image| binder.tape().constant(image.clone()));
        let said = net.forward(binder, first, second);
        let said = Var::concat(&[said.axis_angle, said.translation], 1).scale(100.0);
        let target = POSE.map(|x| x as f32).to_vec();
        said.sub(binder.tape().constant(Tensor::from_vec(Shape::new(1, 6, 1, 1), target))).square().mean()
    })
}

#[test]
fn nano_pose() {
    pose(PoseNetKind::Nano);
}

#[test]
fn nano_scipad_and_its_frozen_part_stays() {
    let [before, after] = pose(PoseNetKind::NanoScipad);
    let mut frozen = 0;
    for ((path, before), (_, after)) in before.iter().zip(after.iter()) {
        let same = before.tensor().data() == after.tensor().data();
        match before.kind() {
            Kind::Frozen => {
                frozen += 1;
                assert!(same, "{path} is frozen");
            }
            Kind::Buffer => assert!(!same, "{path} does not follow the batches"),
            // The fourth projection is never used, and points that are all zeros say nothing about their weights.
            Kind::Parameter => {
                let idle = path.contains("chn_reduction.3") || path.ends_with("pc_embed.0.weight");
                assert_eq!(same, idle, "{path}");
            }
        }
    }
    assert!(frozen > 0);
}

fn flow(config: FlowNetConfig, pace: (f32, usize)) {
    let net = FlowNet::new(config);
    let pair = pair();
    let target = Tensor::from_fn(SIZE.with_c(2), |_, c, v, u| displacement(u as f64, v as f64)[c] as f32);
    overfit(&net, pace, |binder| {
        let [first, second] = pair.each_ref().map(|image| binder.tape().constant(image.clone()));
        let target = binder.tape().constant(target.clone());
        let flows = net.forward(binder, first, second, 4);
        let weighted = flows.iter().rev().zip(0..).map(|(flow, k)| flow.sub(target).abs().mean().scale(0.8f64.powi(k)));
        weighted.reduce(Var::add).unwrap()
    });
}

#[test]
fn nano_raft() {
    flow(FlowNetKind::NanoRaft.config(), (2e-3, 120));
}

#[test]
fn nano_raft_d4() {
    flow(FlowNetKind::NanoRaftD4.config(), (2e-3, 120));
}

/// The parts of the full network, small.
#[test]
fn raft_full_of_few_channels() {
    let full = RaftFull { lookup: 32, mask: 32, statistics: TrainingStatistics::Batch };
    flow(FlowNetConfig { variant: RaftVariant::Full(full), ..FlowNetConfig::nano_raft() }, (2e-3, 120));
}
