//! `dimode pretrain`: what it refuses, and that a refusal leaves the disk as it was.

use std::fs;
use std::path::Path;

use crate::{Ran, dimode, text};

/// A training so short that only what stands around it matters.
fn pretrain(network: &str, out: &Path, more: &[&str]) -> Ran {
    let short = ["--steps", "1", "--batch", "2", "--size", "64x64", "--preset-mix", "lateral"];
    let mut args = vec!["pretrain", network, "--out", text(out)];
    // A flag that is given must not be there twice.
    args.extend(short.chunks(2).filter(|pair| !more.contains(&pair[0])).flatten());
    args.extend(more);
    dimode(&args)
}

fn entries(folder: &Path) -> usize {
    fs::read_dir(folder).unwrap().count()
}

#[test]
fn settings_out_of_range_are_refused_before_anything_is_made() {
    let place = tempfile::tempdir().unwrap();
    let out = place.path().join("new/weights");
    for network in ["flow", "pose"] {
        for (flag, value, advice) in [
            ("--steps", "0", "use 1 to 4294967296"),
            ("--steps", "4294967297", "use 1 to 4294967296"),
            ("--batch", "0", "use 1 to 1024"),
            ("--batch", "100000000000", "use 1 to 1024"),
            ("--learning-rate", "0", "use a finite number above 0"),
            ("--size", "63x64", "use multiples of 32"),
        ] {
            pretrain(network, &out, &[flag, value]).refused(2, &[&format!("{flag} {value}"), &format!("fix: {advice}")]);
        }
    }
    for iterations in ["0", "65"] {
        pretrain("flow", &out, &["--iterations", iterations]).refused(2, &["--iterations", "fix: use 1 to 64"]);
    }
    pretrain("pose", &out, &["--batch", "3"]).refused(2, &["--batch 3", "fix: use an even number"]);
    assert_eq!(entries(place.path()), 0);
}

#[test]
fn places_that_cannot_take_the_weights_are_refused_before_the_training() {
    let place = tempfile::tempdir().unwrap();
    let (folder, file) = (place.path().join("frames"), place.path().join("file"));
    fs::create_dir(&folder).unwrap();
    fs::write(folder.join("000001.png"), "precious").unwrap();
    fs::write(&file, "kept").unwrap();
    // A training that began would break down and say so.
    let wild = ["--force", "--learning-rate", "1e38"];
    pretrain("flow", &folder, &wild).refused(2, &["frames: a folder", "fix: name a file"]);
    pretrain("flow", &place.path().join("new/sub/"), &wild).refused(2, &["new/sub/: a folder", "fix: name a file"]);
    pretrain("pose", &folder, &wild).refused(2, &["frames: not empty, and not made by this command", "fix: name another folder"]);
    pretrain("pose", &file, &wild).refused(1, &["file: cannot be written", "fix: a file is in the way"]);
    for network in ["flow", "pose"] {
        pretrain(network, &file.join("weights"), &wild).refused(1, &["file/weights: cannot be written", "fix: "]);
    }
    assert_eq!((entries(place.path()), entries(&folder)), (2, 1));
    assert_eq!(fs::read_to_string(&file).unwrap(), "kept");
}

#[test]
fn older_weights_are_replaced_on_request_only() {
    let place = tempfile::tempdir().unwrap();
    for (network, file) in [("flow", "flow"), ("pose", "pose/pose.safetensors")] {
        let out = place.path().join(network);
        let bytes = || fs::read(place.path().join(file)).unwrap();
        pretrain(network, &out, &[]).succeeded();
        let first = bytes();
        pretrain(network, &out, &["--seed", "2"]).refused(2, &[&format!("{network}: already written"), "--force"]);
        assert!(bytes() == first);
        pretrain(network, &out, &["--seed", "2", "--force"]).succeeded();
        assert!(bytes() != first);
    }
    assert_eq!(entries(place.path()), 2);
}

#[test]
fn a_training_that_breaks_down_writes_nothing() {
    let place = tempfile::tempdir().unwrap();
    for network in ["flow", "pose"] {
        let ran = pretrain(network, &place.path().join("weights"), &["--learning-rate", "1e38"]);
        ran.refused(1, &["step 1: ", "is not finite; nothing was written", "fix: lower --learning-rate"]);
    }
    assert_eq!(entries(place.path()), 0);
}
