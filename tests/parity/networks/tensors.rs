//! The parameters themselves: values of the fill rule, and names, shapes and sums of every network.

use std::collections::BTreeMap;

use dimode_nets::{DepthNet, DepthNetKind, FlowNet, FlowNetKind, Kind, Network, PoseNet, PoseNetKind, fill};

use crate::store::{available, gain, manifest, open};

#[test]
fn fill_rule_matches_the_probe() {
    let golden = open("fill_probe");
    let mut count = 0;
    for name in golden.names() {
        let stored = golden.get(name).unwrap();
        let values: Vec<f64> = match name.split_once('|').unwrap() {
            ("uniform", key) => (0..stored.values.len()).map(|i| fill::unit(key, i)).collect(),
            (key, gain) => {
                let gain = gain.strip_prefix("gain=").unwrap().parse().unwrap();
                fill::values(key, &stored.dims, gain)
            }
        };
        // PyTorch's square root of a rounded product may differ in the last bit before the rounding to f32.
        for (a, b) in values.iter().zip(&stored.values) {
            assert!((a - b).abs() <= 1e-15 * b.abs(), "{name}: {a} against {b}");
        }
        count += 1;
    }
    assert_eq!(count, 11);
}

/// Every tensor of the manifest exists with its dimensions, kind and sums, and no other does.
fn check_manifest(name: &str, network: &impl Network) {
    let manifest = manifest(name);
    let set = network.blueprint().filled::<f64>(|file| gain(&manifest, file));
    let mut expected = BTreeMap::new();
    for (file, content) in manifest.as_object().unwrap() {
        for tensor in content["tensors"].as_array().unwrap() {
            let key = tensor["key"].as_str().unwrap();
            if !key.ends_with("num_batches_tracked") {
                expected.insert(format!("{file}:{key}"), tensor.clone());
            }
        }
    }
    // The reference registers some norms of RAFT twice, here they have one name.
    let twice = |path: &String| set.get(path).is_none() && set.get(&path.replace(".downsample.1.", ".norm3.")).is_some();
    expected.retain(|path, _| !twice(path));
    for (path, entry) in set.iter() {
        let Some(tensor) = expected.remove(&path) else {
            panic!("{name}: {path} is not in the manifest");
        };
        let dims: Vec<usize> = serde_json::from_value(tensor["shape"].clone()).unwrap();
        assert_eq!(entry.dims(), dims, "{path}");
        let kind = match entry.kind() {
            Kind::Parameter | Kind::Frozen => "parameter",
            Kind::Buffer => "buffer",
        };
        assert_eq!(tensor["kind"], kind, "{path}");
        let values = entry.tensor().data();
        let magnitude = tensor["abs_sum"].as_f64().unwrap();
        let near = |a: f64, b: f64| (a - b).abs() <= 1e-10 * magnitude;
        let sum: f64 = values.iter().sum();
        assert!(near(sum, tensor["sum"].as_f64().unwrap()), "{path}: sum {sum}");
        let sum: f64 = values.iter().map(|v| v.abs()).sum();
        assert!(near(sum, magnitude), "{path}: sum of magnitudes {sum}");
    }
    let left: Vec<&String> = expected.keys().collect();
    assert!(left.is_empty(), "{name}: missing {left:?}");
}

#[test]
fn depth_networks_have_the_tensors_of_the_reference() {
    check_manifest("nano_resnet_depth", &DepthNet::new(DepthNetKind::NanoResnet.config()));
    check_manifest("nano_lite_mono", &DepthNet::new(DepthNetKind::NanoLiteMono.config()));
    check_manifest("nano_d_hrnet", &DepthNet::new(DepthNetKind::NanoDHrNet.config()));
    let full = [
        ("resnet18_depth", DepthNetKind::Resnet18),
        ("lite_mono", DepthNetKind::LiteMono),
        ("lite_mono_tiny", DepthNetKind::LiteMonoTiny),
        ("d_hrnet", DepthNetKind::DHrNet),
    ];
    for (name, kind) in full.into_iter().filter(|(name, _)| available(name)) {
        check_manifest(name, &DepthNet::new(kind.config()));
    }
}

#[test]
fn pose_networks_have_the_tensors_of_the_reference() {
    check_manifest("nano_pose", &PoseNet::new(PoseNetKind::Nano.config()));
    check_manifest("nano_scipad", &PoseNet::new(PoseNetKind::NanoScipad.config()));
    if available("resnet18_pose") {
        check_manifest("resnet18_pose", &PoseNet::new(PoseNetKind::Resnet18.config()));
    }
    if available("scipad_pose") {
        check_manifest("scipad_pose", &PoseNet::new(PoseNetKind::Scipad.config()));
    }
}

#[test]
fn flow_networks_have_the_tensors_of_the_reference() {
    check_manifest("nano_raft", &FlowNet::new(FlowNetKind::NanoRaft.config()));
    check_manifest("nano_raft_d4", &FlowNet::new(FlowNetKind::NanoRaftD4.config()));
    if available("raft_small") {
        check_manifest("raft_small", &FlowNet::new(FlowNetKind::RaftSmall.config()));
    }
    if available("raft_full") {
        check_manifest("raft_full", &FlowNet::new(FlowNetKind::RaftFull.config()));
    }
}
