//! Flow networks against the golden tensors.

use dimode_autodiff::{Scalar, Var};
use dimode_nets::{Binder, FlowNet, FlowNetKind, FlowOptions, ImageRange, Mode};

use crate::compare::{Case, Limits, Run, compare};
use crate::store::available;

fn run<'t, T: Scalar>(net: &FlowNet, binder: &mut Binder<'t, T>, inputs: &[Var<'t, T>]) -> Run<'t, T> {
    let options = FlowOptions { iterations: Some(4), range: ImageRange::Byte, last_only: false };
    let trace = net.trace(binder, inputs[0], inputs[1], &options);
    let name = |kind: &'static str| move |(i, &var): (usize, _)| (format!("{kind}{i}"), var);
    let mut mids: Vec<_> = trace.deltas.iter().enumerate().map(name("delta")).collect();
    mids.push(("fmap1".to_owned(), trace.features.slice(0, 0, 1)));
    mids.push(("fmap2".to_owned(), trace.features.slice(0, 1, 1)));
    mids.push(("cnet".to_owned(), trace.context));
    mids.push(("corr0".to_owned(), trace.first_lookup.unwrap()));
    mids.push(("net3".to_owned(), trace.hidden));
    Run { outputs: trace.flows.iter().enumerate().map(name("flow")).collect(), mids }
}

fn check(kind: FlowNetKind, limit: f64) {
    let case = Case {
        name: &kind.to_string(),
        mode: Mode::Eval,
        inputs: &["image1", "image2"],
        limits: Limits { out: limit, mid: 4e-5, grad: 1e-3, stat: 0.0 },
    };
    let net = FlowNet::new(kind.config());
    compare::<f64, _, _>(&case, &net, |binder, inputs| run(&net, binder, inputs));
    compare::<f32, _, _>(&case, &net, |binder, inputs| run(&net, binder, inputs));
}

#[test]
fn nano_raft() {
    check(FlowNetKind::NanoRaft, 2e-5);
}

#[test]
fn nano_raft_d4() {
    check(FlowNetKind::NanoRaftD4, 2e-5);
}

#[test]
fn raft_small() {
    if available("raft_small") {
        check(FlowNetKind::RaftSmall, 4e-5);
    }
}

#[test]
fn raft_full() {
    if available("raft_full") {
        check(FlowNetKind::RaftFull, 2e-5);
    }
}
