use std::fs;
use std::path::Path;

use crate::{dimode, text};

fn synth(out: &Path, more: &[&str]) -> crate::Ran {
    let base = ["synth", "--worlds", "1", "--frames", "3", "--size", "32x16", "--out", text(out)];
    dimode(&[&base, more].concat())
}

fn bytes_below(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut found = Vec::new();
    let mut open = vec![folder.to_owned()];
    while let Some(next) = open.pop() {
        for entry in fs::read_dir(next).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
            } else {
                let name = path.strip_prefix(folder).unwrap().display().to_string();
                found.push((name, fs::read(&path).unwrap()));
            }
        }
    }
    found.sort();
    found
}

#[test]
fn the_same_flags_give_the_same_bytes_with_any_number_of_threads() {
    let place = tempfile::tempdir().unwrap();
    let (a, b, c) = (place.path().join("a"), place.path().join("b"), place.path().join("c"));
    synth(&a, &["--threads", "1"]).succeeded();
    synth(&b, &["--threads", "2"]).succeeded();
    synth(&c, &["--seed", "2"]).succeeded();
    assert_eq!(bytes_below(&a), bytes_below(&b));
    assert_ne!(bytes_below(&a), bytes_below(&c));
}

#[test]
fn the_layout_is_that_of_kitti_odometry() {
    let place = tempfile::tempdir().unwrap();
    let out = place.path().join("worlds");
    let summary = synth(&out, &["--json", "--night", "--noise", "0.05", "--moving-object", "--exposure", "0.2"]).succeeded();
    let summary: serde_json::Value = serde_json::from_str(&summary).unwrap();
    assert_eq!((summary["sequences"].as_u64(), summary["frames"].as_u64()), (Some(1), Some(3)));
    for file in
        ["sequences/00/image_2/000002.png", "sequences/00/calib.txt", "poses/00.txt", "depth/00/000000.png", "flow/00/000000.png"]
    {
        assert!(out.join(file).is_file(), "{file}");
    }
}

#[test]
fn folders_are_replaced_only_when_asked() {
    let place = tempfile::tempdir().unwrap();
    let out = place.path().join("worlds");
    synth(&out, &[]).succeeded();
    synth(&out, &[]).refused(2, &["already written", "add --force"]);
    synth(&out, &["--force"]).succeeded();
    fs::write(out.join("mine.txt"), "x").unwrap();
    let not_ours = ["not made by this command", "fix: name another folder, --force will not replace this one"];
    synth(&out, &["--force"]).refused(2, &not_ours);
    synth(&out, &[]).refused(2, &not_ours);
    assert!(out.join("mine.txt").exists());
    let other = place.path().join("of another program");
    fs::create_dir_all(other.join("sequences/00")).unwrap();
    fs::write(other.join("sequences/00/mine.txt"), "x").unwrap();
    synth(&other, &["--force"]).refused(2, &not_ours);
    assert!(other.join("sequences/00/mine.txt").exists());
}

#[test]
fn settings_out_of_range_write_nothing() {
    let place = tempfile::tempdir().unwrap();
    let out = place.path().join("worlds");
    synth(&out, &["--noise", "3"]).refused(2, &["noise = 3"]);
    dimode(&["synth", "--size", "4x4", "--out", text(&out)]).refused(2, &["width = 4"]);
    assert_eq!(fs::read_dir(place.path()).unwrap().count(), 0);
}

#[cfg(unix)]
#[test]
fn ctrl_c_ends_with_130_and_leaves_nothing() {
    use crate::training::{signal, wait_until};
    use crate::{command, finished};
    use std::process::Stdio;

    let place = tempfile::tempdir().unwrap();
    let (out, partial) = (place.path().join("worlds"), place.path().join("worlds.partial"));
    let flags = ["synth", "--frames", "5000", "--size", "32x16", "--out", text(&out)];
    let mut child = command(&flags).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    wait_until(&mut child, || partial.join("sequences/00/image_2/000000.png").exists());
    signal(&child, "-INT");
    let ran = finished(child.wait_with_output().unwrap());
    assert_eq!(ran.code, 130, "{}", ran.err);
    assert!(ran.err.contains("nothing will be written"), "{}", ran.err);
    assert_eq!(fs::read_dir(place.path()).unwrap().count(), 0);
}
