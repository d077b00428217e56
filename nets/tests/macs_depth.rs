//! Multiply-accumulates of the depth networks against the table of the reference.

use dimode_autodiff::{Shape, Tape, Tensor};
use dimode_nets::{Binder, DepthNet, DepthNetKind, Network};

/// Multiply-accumulates of encoder and decoder for one image.
fn macs(kind: DepthNetKind, height: usize, width: usize) -> [u64; 2] {
    let net = DepthNet::new(kind.config());
    let params = net.init::<f32>(1);
    let tape = Tape::new();
    let mut binder = Binder::frozen(&tape, &params);
    let images = tape.constant(Tensor::full(Shape::new(1, 3, height, width), 0.5));
    let encoder = match &net {
        DepthNet::ResNet(net) => {
            let features = net.features(&mut binder, images);
            let encoder = binder.macs();
            net.decode(&binder, &features);
            encoder
        }
        DepthNet::LiteMono(net) => {
            let features = net.features(&mut binder, images);
            let encoder = binder.macs();
            net.decode(&binder, &features);
            encoder
        }
        DepthNet::DHrNet(net) => {
            let features = net.features(&mut binder, images);
            let encoder = binder.macs();
            net.decode(&binder, &features);
            encoder
        }
    };
    [encoder, binder.macs() - encoder]
}

/// Encoder, decoder and both at 640x192, in billions with three decimals.
const FULL: [(DepthNetKind, [&str; 3]); 6] = [
    (DepthNetKind::Resnet18, ["4.441", "3.572", "8.013"]),
    (DepthNetKind::LiteMono, ["4.296", "0.718", "5.015"]),
    (DepthNetKind::LiteMonoSmall, ["4.012", "0.718", "4.730"]),
    (DepthNetKind::LiteMonoTiny, ["2.362", "0.468", "2.829"]),
    (DepthNetKind::LiteMono8m, ["9.495", "1.703", "11.197"]),
    (DepthNetKind::DHrNet, ["8.038", "2.622", "10.659"]),
];

fn rounded([encoder, decoder]: [u64; 2], unit: f64, decimals: usize) -> [String; 3] {
    [encoder, decoder, encoder + decoder].map(|macs| format!("{:.decimals$}", macs as f64 / unit))
}

#[test]
fn full_networks_cost_what_the_table_says() {
    for (kind, expected) in FULL {
        let found = macs(kind, 192, 640);
        println!("{kind}: {found:?}");
        assert_eq!(rounded(found, 1e9, 3), expected, "{kind}");
    }
}

#[test]
fn nano_networks_cost_what_the_table_says() {
    let table = [
        (DepthNetKind::NanoResnet, "13.19", "26.39"),
        (DepthNetKind::NanoLiteMono, "19.08", "38.17"),
        (DepthNetKind::NanoDHrNet, "26.62", "53.25"),
    ];
    for (kind, narrow, wide) in table {
        let [small, large] = [96, 192].map(|width| macs(kind, 64, width));
        println!("{kind}: {small:?} {large:?}");
        assert_eq!([small, large].map(|macs| rounded(macs, 1e6, 2)[2].clone()), [narrow, wide], "{kind}");
    }
}
