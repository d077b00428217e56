//! Depth networks against the golden tensors.

use dimode_autodiff::{Scalar, Var};
use dimode_nets::{Binder, Mode, ResNetDepth, ResNetDepthConfig};

use crate::compare::{Case, Limits, Run, compare};
use crate::store::available;

fn run<'t, T: Scalar>(net: &ResNetDepth, binder: &mut Binder<'t, T>, inputs: &[Var<'t, T>]) -> Run<'t, T> {
    let features = net.features(binder, inputs[0]);
    let disparities = net.decode(binder, &features);
    let name = |kind: &'static str| move |(i, &var): (usize, _)| (format!("{kind}{i}"), var);
    Run {
        outputs: disparities.iter().enumerate().map(name("disp")).collect(),
        mids: features.iter().enumerate().map(name("feat")).collect(),
    }
}

fn check(name: &str, config: ResNetDepthConfig, mode: Mode, limits: Limits) {
    let case = Case { name, mode, inputs: &["image"], limits };
    let net = ResNetDepth::new(config);
    compare::<f64, _, _>(&case, &net, |binder, inputs| run(&net, binder, inputs));
    compare::<f32, _, _>(&case, &net, |binder, inputs| run(&net, binder, inputs));
}

const EVAL: Limits = Limits { out: 4e-6, mid: 1e-5, grad: 1e-3, stat: 0.0 };
const TRAIN: Limits = Limits { out: 1.2e-5, mid: 2e-5, grad: 1e-3, stat: 6e-6 };

#[test]
fn nano_resnet_depth_eval() {
    check("nano_resnet_depth", ResNetDepthConfig::nano(), Mode::Eval, EVAL);
}

#[test]
fn nano_resnet_depth_train() {
    check("nano_resnet_depth", ResNetDepthConfig::nano(), Mode::Train, TRAIN);
}

#[test]
fn resnet18_depth() {
    if !available("resnet18_depth") {
        return;
    }
    let train = Limits { out: 2e-5, mid: 6e-5, stat: 2e-6, ..TRAIN };
    check("resnet18_depth", ResNetDepthConfig::resnet18(), Mode::Eval, EVAL);
    check("resnet18_depth", ResNetDepthConfig::resnet18(), Mode::Train, train);
}
