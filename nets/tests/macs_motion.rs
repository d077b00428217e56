//! Multiply-accumulates of pose and flow networks, as published sizes and definitions give them.

use dimode_autodiff::{Shape, Tape, Tensor};
use dimode_nets::{Binder, FlowNet, FlowNetKind, FlowOptions, Mode, Network, PoseNet, PoseNetKind};

/// Of one pair of width x height.
fn pose(kind: PoseNetKind, (width, height): (usize, usize), mode: Mode) -> u64 {
    let net = PoseNet::new(kind.config());
    let params = net.init::<f32>(1);
    let tape = Tape::new();
    let mut binder = Binder::selective(&tape, &params, mode, |_| false);
    let image = tape.constant(Tensor::full(Shape::new(1, 3, height, width), 0.5));
    net.forward(&mut binder, image, image);
    binder.macs()
}

/// Of one pair of width x height, with as many refinements as configured.
fn flow(kind: FlowNetKind, (width, height): (usize, usize), last_only: bool) -> u64 {
    let net = FlowNet::new(kind.config());
    let params = net.init::<f32>(1);
    let tape = Tape::new();
    let mut binder = Binder::frozen(&tape, &params);
    let image = tape.constant(Tensor::full(Shape::new(1, 3, height, width), 0.5));
    net.trace(&mut binder, image, image, &FlowOptions { last_only, ..FlowOptions::default() });
    binder.macs()
}

/// Millions, as many digits as asked for.
fn millions(macs: u64, digits: usize) -> String {
    format!("{:.digits$}", macs as f64 / 1e6)
}

/// Thousandths of a billion.
fn billions(macs: u64) -> String {
    format!("{:.3}", macs as f64 / 1e9)
}

const SMALL: (usize, usize) = (96, 64);
const WIDE: (usize, usize) = (192, 64);
const FULL: (usize, usize) = (640, 192);
/// Inner products over windows in the feature flow of nano_scipad at 96x64: channels, places of the window, cells.
const NANO_WINDOWS: u64 = 16 * 81 * 16 * 24 + 32 * 25 * 8 * 12 + 64 * 9 * 4 * 6;

#[test]
fn nano_pose_networks() {
    for mode in [Mode::Train, Mode::Eval] {
        let counts = |kind| [SMALL, WIDE].map(|size| pose(kind, size, mode));
        let texts = |counts: [u64; 2]| counts.map(|macs| millions(macs, 2));
        assert_eq!(texts(counts(PoseNetKind::Nano)), ["13.62", "27.24"]);
        // The published count of the reference size has the window products, that of the nano size has not.
        let [small, wide] = counts(PoseNetKind::NanoScipad);
        assert_eq!(texts([small, wide]), ["13.14", "26.27"], "{mode:?}");
        assert_eq!(texts([small - NANO_WINDOWS, wide - 2 * NANO_WINDOWS]), ["12.55", "25.10"], "{mode:?}");
    }
}

#[test]
fn nano_flow_networks() {
    let small = |kind, last_only, digits| millions(flow(kind, SMALL, last_only), digits);
    let wide = |kind, last_only| millions(flow(kind, WIDE, last_only), 1);
    for last_only in [false, true] {
        assert_eq!([small(FlowNetKind::NanoRaft, last_only, 2), wide(FlowNetKind::NanoRaft, last_only)], ["68.32", "137.5"]);
        assert_eq!([small(FlowNetKind::NanoRaftD4, last_only, 1), wide(FlowNetKind::NanoRaftD4, last_only)], ["231.5", "477.1"]);
    }
}

#[test]
fn reference_sizes() {
    assert_eq!(billions(pose(PoseNetKind::Resnet18, FULL, Mode::Eval)), "4.888");
    for mode in [Mode::Eval, Mode::Train] {
        assert_eq!(billions(pose(PoseNetKind::Scipad, FULL, mode)), "27.020");
    }
    assert_eq!(billions(flow(FlowNetKind::RaftSmall, FULL, true)), "21.804");
    for last_only in [false, true] {
        assert_eq!(billions(flow(FlowNetKind::RaftFull, FULL, last_only)), "97.840");
    }
}
