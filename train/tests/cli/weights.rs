use std::fs;
use std::path::{Path, PathBuf};

use dimode_nets::{NetKind, weights};

use crate::{dimode, dimode_in, text};

/// A file that PyTorch wrote.
fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../nets/tests/data/weights").join(name)
}

fn saved(folder: &Path, net: &str, seed: u64) {
    let net: NetKind = net.parse().unwrap();
    weights::save_directory(folder, &net.blueprint().init::<f32>(seed)).unwrap();
}

#[test]
fn a_file_is_told_as_text_and_as_json() {
    let path = fixture("with_sizes.pth");
    let told = dimode(&["weights", "inspect", text(&path)]).succeeded();
    for part in ["PyTorch zip file", "3 tensors, 17 values", "1 counter", "height: 192", "no network here", "conv.weight"] {
        assert!(told.contains(part), "'{part}' is not in {told}");
    }
    let found: serde_json::Value =
        serde_json::from_str(&dimode(&["weights", "inspect", text(&path), "--json"]).succeeded()).unwrap();
    assert_eq!((found["values"].as_u64(), found["tensors"][0]["max"].as_f64()), (Some(17), Some(0.375)));
    let told = dimode(&["weights", "inspect", text(&fixture("nano_lite_mono_depth.pth"))]).succeeded();
    assert!(told.contains("fits      depth:nano_lite_mono, file depth\n"), "{told}");
}

#[test]
fn executable_content_is_refused_and_not_run() {
    let place = tempfile::tempdir().unwrap();
    let file = fixture("malicious.pth");
    for args in [
        &["weights", "inspect", text(&file)][..],
        &["weights", "convert", "--net", "nano_raft", text(&file), "--out", "out"],
        &["weights", "diff", text(&file), text(&file)],
    ] {
        dimode_in(place.path(), args).refused(1, &["names 'posix.system': executable content is refused", "fix: "]);
    }
    assert_eq!(fs::read_dir(place.path()).unwrap().count(), 0);
    dimode(&["weights", "inspect", text(&fixture("legacy.pth"))]).refused(1, &["PyTorch 1.5", "in Python: torch.save("]);
}

#[test]
fn converted_weights_are_equal_to_their_source() {
    let place = tempfile::tempdir().unwrap();
    let (folder, out) = (place.path().join("in"), place.path().join("out"));
    saved(&folder, "pose:nano", 3);
    let [encoder, pose] = ["pose_encoder", "pose"].map(|file| folder.join(format!("{file}.safetensors")));
    let convert = ["weights", "convert", "--net", "pose:nano", text(&encoder), text(&pose), "--out", text(&out)];
    let told = dimode(&convert).succeeded();
    assert!(told.contains("out/pose.safetensors: 8 of 8 tensors from "), "{told}");
    dimode(&convert).refused(2, &["--force"]);
    dimode(&[&convert[..], &["--force"]].concat()).succeeded();
    let told = dimode(&["weights", "diff", text(&folder), text(&out)]).succeeded();
    assert!(told.contains("equal, exactly; the largest difference is 0.000e0"), "{told}");

    saved(&out, "pose:nano", 4);
    let ran = dimode(&["weights", "diff", text(&folder), text(&out), "--json"]);
    let found: serde_json::Value = serde_json::from_str(&ran.out).unwrap();
    assert_eq!((ran.code, ran.err.as_str(), found["equal"].as_bool()), (1, "", Some(false)));
    let ran = dimode(&["weights", "diff", text(&folder), text(&out), "--tolerance", "10"]);
    assert_eq!(ran.code, 0, "{}", ran.out);
}

#[test]
fn every_difference_is_listed_before_the_error() {
    let place = tempfile::tempdir().unwrap();
    let (folder, out) = (place.path().join("in"), place.path().join("out"));
    saved(&folder, "nano_raft", 3);
    let file = folder.join("raft.safetensors");
    let ran = dimode(&["weights", "convert", "--net", "raft_small", text(&file), "--out", text(&out)]);
    assert_eq!((ran.code, ran.out.as_str()), (1, ""));
    let listed = ran.err.lines().filter(|line| line.starts_with("raft of another size: ")).count();
    assert!(listed > 50 && ran.err.contains(&format!("tensors: {listed} of another size (")), "{}", ran.err);
    assert!(ran.err.ends_with("or take what fits with --partial\n"), "{}", ran.err);
    assert!(!out.exists());
}

#[test]
fn wrong_usage_ends_with_2() {
    let file = fixture("plain.pth");
    let convert = |net: &str| dimode(&["weights", "convert", "--net", net, text(&file), "--out", "nowhere"]);
    assert_eq!(convert("resnet18").code, 2);
    assert!(convert("resnet18").err.contains("write depth:resnet18 or pose:resnet18"));
    convert("pose:nano").refused(2, &["plain.pth: neither its name nor its tensors", "fix: write FILE=PATH"]);
    dimode(&["weights", "diff", text(&file), text(&file), "--tolerance", "nan"])
        .refused(2, &["--tolerance NaN", "fix: use a number from 0 on"]);
    dimode(&["weights", "inspect", "no such file"]).refused(1, &["cannot read weights from no such file"]);
}
