//! Depth networks against the golden tensors.

use dimode_autodiff::{Scalar, Var};
use dimode_nets::{Binder, DepthNet, DepthNetKind, Mode};

use crate::compare::{Case, EXACT, Limits, Run, compare_within};
use crate::store::available;

fn run<'t, T: Scalar>(net: &DepthNet, binder: &mut Binder<'t, T>, inputs: &[Var<'t, T>]) -> Run<'t, T> {
    let image = inputs[0];
    let (features, disparities) = match net {
        DepthNet::ResNet(net) => {
            let features = net.features(binder, image);
            (features.to_vec(), net.decode(binder, &features))
        }
        DepthNet::LiteMono(net) => {
            let features = net.features(binder, image);
            (features.to_vec(), net.decode(binder, &features))
        }
        DepthNet::DHrNet(net) => {
            let features = net.features(binder, image);
            (features.to_vec(), vec![net.decode(binder, &features)])
        }
    };
    assert_eq!(disparities.len(), net.scales());
    let name = |kind: &'static str| move |(i, &var): (usize, _)| (format!("{kind}{i}"), var);
    Run {
        outputs: disparities.iter().enumerate().map(name("disp")).collect(),
        mids: features.iter().enumerate().map(name("feat")).collect(),
    }
}

fn check(name: &str, kind: DepthNetKind, mode: Mode, limits: Limits) {
    // The golden numbers of the nano Lite-Mono were made with the periods of its positional code rounded to float32, in float64
    // as well; those of the full ones were not. With periods rounded alike, all numbers agree to 3e-15, without to 1.5e-8.
    let exact = if kind == DepthNetKind::NanoLiteMono { 2e-8 } else { EXACT };
    let case = Case { name, mode, inputs: &["image"], limits };
    let net = DepthNet::new(kind.config());
    compare_within::<f64, _, _>(exact, &case, &net, |binder, inputs| run(&net, binder, inputs));
    compare_within::<f32, _, _>(exact, &case, &net, |binder, inputs| run(&net, binder, inputs));
}

const EVAL: Limits = Limits { out: 4e-6, mid: 1e-5, grad: 1e-3, stat: 0.0 };
const TRAIN: Limits = Limits { out: 1.2e-5, mid: 2e-5, grad: 1e-3, stat: 6e-6 };

#[test]
fn nano_resnet_depth_eval() {
    check("nano_resnet_depth", DepthNetKind::NanoResnet, Mode::Eval, EVAL);
}

#[test]
fn nano_resnet_depth_train() {
    check("nano_resnet_depth", DepthNetKind::NanoResnet, Mode::Train, TRAIN);
}

#[test]
fn resnet18_depth() {
    if !available("resnet18_depth") {
        return;
    }
    let train = Limits { out: 2e-5, mid: 6e-5, stat: 2e-6, ..TRAIN };
    check("resnet18_depth", DepthNetKind::Resnet18, Mode::Eval, EVAL);
    check("resnet18_depth", DepthNetKind::Resnet18, Mode::Train, train);
}

const LITE_MONO_EVAL: Limits = Limits { out: 6e-6, ..EVAL };
const LITE_MONO_TRAIN: Limits = Limits { out: 1e-5, mid: 1.4e-5, grad: 1e-3, stat: 4e-6 };

#[test]
fn nano_lite_mono_eval() {
    check("nano_lite_mono", DepthNetKind::NanoLiteMono, Mode::Eval, LITE_MONO_EVAL);
}

#[test]
fn nano_lite_mono_train() {
    check("nano_lite_mono", DepthNetKind::NanoLiteMono, Mode::Train, LITE_MONO_TRAIN);
}

#[test]
fn lite_mono() {
    if !available("lite_mono") {
        return;
    }
    check("lite_mono", DepthNetKind::LiteMono, Mode::Eval, Limits { mid: 1.6e-5, ..LITE_MONO_EVAL });
    let train = Limits { mid: 2e-5, stat: 2e-6, ..LITE_MONO_TRAIN };
    check("lite_mono", DepthNetKind::LiteMono, Mode::Train, train);
}

#[test]
fn lite_mono_tiny() {
    if !available("lite_mono_tiny") {
        return;
    }
    check("lite_mono_tiny", DepthNetKind::LiteMonoTiny, Mode::Eval, Limits { mid: 1.4e-5, ..LITE_MONO_EVAL });
    let train = Limits { out: 1.2e-5, mid: 1.8e-5, stat: 2e-6, ..LITE_MONO_TRAIN };
    check("lite_mono_tiny", DepthNetKind::LiteMonoTiny, Mode::Train, train);
}

#[test]
fn nano_d_hrnet_eval() {
    let limits = Limits { out: 1.8e-6, mid: 4e-6, ..EVAL };
    check("nano_d_hrnet", DepthNetKind::NanoDHrNet, Mode::Eval, limits);
}

#[test]
fn nano_d_hrnet_train() {
    let limits = Limits { out: 1.6e-5, mid: 6e-5, grad: 1e-3, stat: 6e-6 };
    check("nano_d_hrnet", DepthNetKind::NanoDHrNet, Mode::Train, limits);
}

#[test]
fn d_hrnet() {
    if !available("d_hrnet") {
        return;
    }
    check("d_hrnet", DepthNetKind::DHrNet, Mode::Eval, Limits { mid: 8e-6, ..EVAL });
    // Sixty normalisations over as few as twelve values amplify rounding: in training even the reference's own gradients in
    // float32 are 5e-4 away from those in float64, where a switched unit moves them by a finite amount. Float64 decides.
    let train = Limits { out: 8e-5, mid: 4e-4, grad: 3e-2, stat: 4e-5 };
    check("d_hrnet", DepthNetKind::DHrNet, Mode::Train, train);
}
