use std::fs;
use std::path::{Path, PathBuf};

use dimode::data::{Image, image_size, read_depth_png, read_flo, read_flow_png, write_rgb_png};
use dimode::model::DepthRange;
use dimode_nets::{DepthNet, DepthNetKind, FlowNet, FlowNetKind, Network, PoseNet, PoseNetKind, weights};
use serde_json::Value;

use crate::{Ran, dimode, text};

struct Place {
    folder: tempfile::TempDir,
}

impl Place {
    /// Frames of 96x80 pixels without a camera, and fresh weights of three networks.
    fn new() -> Self {
        let place = Place { folder: tempfile::tempdir().unwrap() };
        let data = place.path("frames");
        fs::create_dir(&data).unwrap();
        for i in 0..4 {
            let colour = |c, v, u| 0.5 + 0.4 * (0.3 * (u + 2 * i) as f32 + c as f32).sin() * (0.2 * v as f32).cos();
            write_rgb_png(&data.join(format!("{i:06}.png")), &Image::from_fn(3, 80, 96, colour)).unwrap();
        }
        weights::save_directory(&place.path("depth"), &DepthNet::new(DepthNetKind::NanoResnet.config()).init::<f32>(1)).unwrap();
        weights::save_directory(&place.path("pose"), &PoseNet::new(PoseNetKind::Nano.config()).init::<f32>(2)).unwrap();
        weights::save_directory(&place.path("flow"), &FlowNet::new(FlowNetKind::NanoRaft.config()).init::<f32>(3)).unwrap();
        place
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn infer(&self, out: &str, args: &[&str]) -> Ran {
        let (data, out) = (self.path("frames"), self.path(out));
        let args: Vec<String> = args.iter().map(|arg| arg.replace("PLACE", text(self.folder.path()))).collect();
        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        dimode(&[&["infer", "--data", text(&data), "--out", text(&out), "--size", "96x64"], &args[..]].concat())
    }
}

const DEPTH: [&str; 4] = ["--depth", "nano_resnet", "--depth-weights", "PLACE/depth"];
const POSE: [&str; 4] = ["--pose", "nano", "--pose-weights", "PLACE/pose"];
const FLOW: [&str; 4] = ["--flow", "nano_raft", "--flow-weights", "PLACE/flow/raft.safetensors"];

fn entries(folder: &Path) -> Vec<String> {
    let name = |entry: Result<fs::DirEntry, _>| entry.unwrap().file_name().into_string().unwrap();
    let mut names: Vec<String> = fs::read_dir(folder).unwrap().map(name).collect();
    names.sort();
    names
}

/// Height, width and values of an NPY file of floats.
fn npy(path: &Path) -> (usize, Vec<f32>) {
    let bytes = fs::read(path).unwrap();
    let header = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let words = bytes[header..].chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let text = String::from_utf8_lossy(&bytes[10..header]).into_owned();
    let height = text.split("'shape': (").nth(1).and_then(|rest| rest.split(',').next()).unwrap().parse().unwrap();
    (height, words.collect())
}

#[test]
fn three_networks_by_name_write_everything_at_the_size_of_the_frames() {
    let place = Place::new();
    let forms = ["--formats", "png,npy,magma,turbo,flo,wheel", "--json"];
    let summary = place.infer("out", &[&DEPTH[..], &POSE, &FLOW, &forms].concat()).succeeded();
    let summary: Value = serde_json::from_str(&summary).unwrap();
    let folder = place.path("out").join(summary[0]["name"].as_str().unwrap());
    let expected = ["depth", "depth_magma", "depth_npy", "depth_turbo", "flow", "flow_colour", "flow_legend.png"];
    assert_eq!(entries(&folder)[..7], expected);
    assert_eq!(entries(&folder)[7..], ["trajectory.kitti.txt", "trajectory.tum.txt"]);
    for (name, count) in [("depth", 4), ("depth_magma", 4), ("depth_npy", 4), ("depth_turbo", 4), ("flow", 6), ("flow_colour", 3)]
    {
        assert_eq!(entries(&folder.join(name)).len(), count, "{name}");
    }
    for picture in ["depth/000003.png", "depth_magma/000000.png", "depth_turbo/000001.png", "flow_colour/000002.png"] {
        assert_eq!(image_size(&folder.join(picture)).unwrap(), (96, 80), "{picture}");
    }
    assert_eq!(fs::read_to_string(folder.join("trajectory.kitti.txt")).unwrap().lines().count(), 4);

    let (height, floats) = npy(&folder.join("depth_npy/000001.npy"));
    let picture = read_depth_png(&folder.join("depth/000001.png")).unwrap();
    assert_eq!((height, floats.len()), (80, 80 * 96));
    for (exact, rounded) in floats.iter().zip(&picture.data) {
        assert!((exact.min(65535.0 / 256.0) - rounded).abs() < 0.51 / 256.0, "{exact} {rounded}");
    }
    let unit = summary[0]["unit"].as_f64().unwrap();
    assert!((unit * DepthRange::MONODEPTH.usual() - 10.0).abs() < 1e-9);
    let (flo, png) =
        (read_flo(&folder.join("flow/000000.flo")).unwrap(), read_flow_png(&folder.join("flow/000000.png")).unwrap());
    assert!(flo.flow.u.iter().zip(&png.flow.u).all(|(a, b)| (a - b).abs() <= 0.51 / 64.0));
    let speed = &summary[0]["speed"];
    for name in ["depth", "pose", "flow", "networks", "whole"] {
        assert!(speed[name].as_f64().unwrap() > 0.0, "{name}: {speed}");
    }
    assert!(speed["networks"].as_f64() < speed["depth"].as_f64());
    assert_eq!(speed["size"], serde_json::json!([96, 64]));
}

#[test]
fn what_has_no_network_is_not_written() {
    let place = Place::new();
    let told = place.infer("depth only", &[&DEPTH[..], &["--formats", "turbo", "--depth-range", "0.2,80"]].concat()).succeeded();
    assert!(told.contains("4 frames in ") && told.contains("frames/s (depth "), "{told}");
    assert_eq!(entries(&place.path("depth only/frames")), ["depth_turbo"]);
    place.infer("pose only", &POSE).succeeded();
    assert_eq!(entries(&place.path("pose only/frames")), ["trajectory.kitti.txt", "trajectory.tum.txt"]);
    let told = place.infer("flow only", &FLOW).succeeded();
    assert!(told.contains("flow in full colour at "), "{told}");
    assert_eq!(entries(&place.path("flow only/frames")), ["flow", "flow_colour", "flow_legend.png"]);
}

#[test]
fn the_unit_scales_depth_and_trajectory_together() {
    let place = Place::new();
    let run = |out: &str, unit: &str| -> (Vec<f32>, f64) {
        let args = [&DEPTH[..], &POSE, &["--formats", "npy", "--json", "--unit", unit]].concat();
        let summary: Value = serde_json::from_str(&place.infer(out, &args).succeeded()).unwrap();
        let (_, depth) = npy(&place.path(out).join("frames/depth_npy/000000.npy"));
        (depth, summary[0]["path_length"].as_f64().unwrap())
    };
    let ((one, path), (four, long)) = (run("one", "1"), run("four", "4"));
    assert!(one.iter().zip(&four).all(|(a, b)| (4.0 * a / b - 1.0).abs() < 1e-5));
    assert!(path > 0.0 && (long / path - 4.0).abs() < 1e-6);
}

#[test]
fn weights_of_another_network_are_refused_and_nothing_is_written() {
    let place = Place::new();
    let out = place.path("out");
    let infer = |args: &[&str]| place.infer("out", args);
    let wrong = ["--depth", "resnet18", "--depth-weights", "PLACE/depth"];
    let parts = ["--depth-weights: ", "does not fit the network", "fix: name what was trained as resnet18"];
    infer(&wrong).refused_with_list(1, "missing: encoder.layer1.1.conv1.weight\n", &parts);
    let one_file = ["--depth", "nano_resnet", "--depth-weights", "PLACE/depth/encoder.safetensors"];
    infer(&one_file).refused(2, &["is one file, nano_resnet has encoder and depth", "fix: name the folder"]);
    infer(&["--pose", "nano", "--pose-weights", "PLACE/none"])
        .refused(1, &["none: pose weights not found", "fix: check --pose-weights"]);
    let file = place.path("flow/raft.safetensors");
    let bytes = fs::read(&file).unwrap();
    fs::write(&file, &bytes[..bytes.len() / 2]).unwrap();
    infer(&FLOW).refused(1, &["--flow-weights: ", "raft.safetensors"]);
    assert!(!out.exists());
}

#[test]
fn flags_that_do_not_go_together_are_refused() {
    let place = Place::new();
    let infer = |args: &[&str]| place.infer("out", args);
    infer(&[&DEPTH[..], &["--formats", "flo"]].concat())
        .refused(2, &["--formats has none for depth", "fix: add one of png, npy, magma, turbo"]);
    infer(&[&FLOW[..], &["--formats", "npy"]].concat())
        .refused(2, &["--formats has none for flow", "fix: add one of png, flo, wheel"]);
    infer(&[]).refused(2, &["no network", "fix: give --run RUN, or any of --depth"]);
    infer(&["--flow"]).refused(2, &["--flow without a name"]);
    infer(&["--flow", "nano_raft"]).refused(2, &["--flow without weights"]);
    infer(&["--run", "r", "--flow", "nano_raft"]).refused(2, &["--flow with a name and --run"]);
    infer(&[&DEPTH[..], &["--unit", "0"]].concat()).refused(2, &["--unit 0"]);
    infer(&[&DEPTH[..], &["--depth-range", "3,2"]].concat()).refused(2, &["--depth-range"]);
    infer(&[&FLOW[..], &["--flow-iterations", "0"]].concat()).refused(2, &["--flow-iterations 0"]);
    for args in [
        &["--depth", "nano_resnet"][..],
        &["--run", "r", "--depth", "nano_resnet", "--depth-weights", "d"],
        &["--formats", "gif"],
    ] {
        assert_eq!(infer(args).code, 2, "{args:?}");
    }
    let (data, out, weights) = (place.path("frames"), place.path("out"), place.path("depth"));
    let named = ["--depth", "nano_resnet", "--depth-weights", text(&weights), "--size", "100x64"];
    let ran = dimode(&[&["infer", "--data", text(&data), "--out", text(&out)], &named[..]].concat());
    ran.refused(2, &["100x64", "fix: choose another --size"]);
    assert!(!place.path("out").exists());
}
