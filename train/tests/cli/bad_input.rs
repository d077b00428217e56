//! Every kind of bad input: one clear message, no run folder left behind.

use std::fs;
use std::path::{Path, PathBuf};

use dimode::data::{Image, write_rgb_png};

use crate::{Ran, dimode, dimode_in, frames, text};

struct Place {
    _folder: tempfile::TempDir,
    data: PathBuf,
    out: PathBuf,
}

fn place(count: usize) -> Place {
    let folder = tempfile::tempdir().unwrap();
    let (data, out) = (folder.path().join("data"), folder.path().join("run"));
    frames(&data, count);
    Place { _folder: folder, data, out }
}

impl Place {
    fn train(&self) -> Ran {
        dimode(&[
            "train",
            "--data",
            text(&self.data),
            "--size",
            "64x64",
            "--steps",
            "1",
            "--batch",
            "1",
            "--out",
            text(&self.out),
        ])
    }

    #[track_caller]
    fn refused(&self, parts: &[&str]) {
        self.train().refused(1, parts);
        assert!(!self.out.exists(), "nothing is left behind");
    }

    fn write(&self, name: &str, text: &str) {
        fs::write(self.data.join(name), text).unwrap();
    }
}

#[test]
fn data_that_does_not_exist() {
    let mut place = place(3);
    place.data = PathBuf::from("no/such/folder");
    place.refused(&["no/such/folder", "not found", "fix: check the path"]);
}

#[test]
fn an_empty_folder() {
    place(0).refused(&["no frames found"]);
}

#[test]
fn one_frame() {
    place(1).refused(&["1 frame", "three frames"]);
}

#[test]
fn frames_of_different_sizes() {
    let place = place(3);
    write_rgb_png(&place.data.join("000001.png"), &Image::zeros(3, 16, 64)).unwrap();
    place.refused(&["000001.png", "64x16", "64x64"]);
}

#[test]
fn a_truncated_picture() {
    let place = place(4);
    let picture = place.data.join("000002.png");
    let bytes = fs::read(&picture).unwrap();
    fs::write(&picture, &bytes[..bytes.len() / 2]).unwrap();
    place.refused(&["000002.png"]);
}

#[test]
fn poses_that_are_not_finite() {
    let place = place(3);
    place.write("poses.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 nan 0 1 0 0 0 0 1 1\n1 0 0 0 0 1 0 0 0 0 1 2\n");
    place.refused(&["poses.txt:2"]);
}

#[test]
fn poses_that_are_no_rotations() {
    let place = place(3);
    place.write("poses.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1 1\n1 0.5 0 0 0 1 0 0 0 0 1 2\n");
    place.refused(&["poses.txt:3", "R^T R"]);
}

#[test]
fn a_focal_length_of_zero() {
    let place = place(3);
    place.write("intrinsics.txt", "0 48 31.5 31.5\n");
    place.refused(&["intrinsics.txt"]);
}

#[test]
fn flow_weights_that_do_not_exist() {
    let place = place(3);
    let ran = dimode(&["train", "--flow-weights", "none.safetensors", "--out", text(&place.out)]);
    ran.refused(1, &["none.safetensors", "flow weights not found"]);
    assert!(!place.out.exists());
}

#[test]
fn pose_weights_that_do_not_exist() {
    let place = place(3);
    let ran = dimode(&["train", "--pose-weights", "none", "--out", text(&place.out)]);
    ran.refused(1, &["none", "pose weights not found"]);
    assert!(!place.out.exists());
}

/// The tests may run as root, whom permissions do not stop; a folder below a file stops everyone.
#[test]
fn an_output_folder_that_cannot_be_made() {
    let place = place(3);
    let file = place.data.join("intrinsics.txt");
    let before = fs::read(&file).unwrap();
    let ran = dimode(&["train", "--quick", "--out", text(&file.join("run"))]);
    ran.refused(1, &["intrinsics.txt/run", "cannot be written", "fix: "]);
    assert_eq!(fs::read(&file).unwrap(), before);
}

#[test]
fn runs_that_are_already_there() {
    let place = place(3);
    fs::create_dir_all(&place.out).unwrap();
    fs::write(place.out.join("checkpoint.safetensors"), "x").unwrap();
    place.train().refused(2, &["not empty, and not the folder of a run", "--out"]);
    let settings = dimode(&["train", "--print-config"]).succeeded();
    fs::write(place.out.join("config.toml"), format!("# dimode train\n{settings}")).unwrap();
    place.train().refused(2, &["unfinished run", "--resume", "--force"]);
    fs::write(place.out.join("metrics.json"), "{}").unwrap();
    place.train().refused(2, &["finished run", "--force"]);
    assert_eq!(fs::read(place.out.join("checkpoint.safetensors")).unwrap(), b"x");
}

#[test]
fn a_configuration_of_ones_own_is_not_overwritten() {
    let place = place(3);
    fs::create_dir_all(&place.out).unwrap();
    let file = place.out.join("config.toml");
    let own = format!("# mine\n{}", dimode(&["train", "--print-config"]).succeeded());
    fs::write(&file, &own).unwrap();
    for more in [&[][..], &["--force"]] {
        let args = ["train", "--config", text(&file), "--out", text(&place.out)];
        dimode(&[&args[..], more].concat()).refused(2, &["not the folder of a run", "name another folder"]);
    }
    assert_eq!(fs::read_to_string(&file).unwrap(), own);
}

#[test]
fn settings_that_the_renderer_refuses() {
    let place = place(3);
    for (setting, message) in [
        ("data.frames=6000", "data.frames = 6000: must be 3 to 5000"),
        ("eval.frames=6000", "eval.frames = 6000: must be 3 to 5000"),
        ("eval.max_depth=0.1001", "eval.min_depth = 0.1: the worlds show nothing"),
    ] {
        let args = ["train", "--quick", "--out", text(&place.out), "--force", "--set", setting];
        dimode(&args).refused(2, &[message]);
        assert!(!place.out.exists(), "nothing is left behind");
    }
}

#[test]
fn resuming_what_is_no_run_or_a_damaged_one() {
    let place = place(3);
    dimode(&["train", "--resume", text(&place.data)]).refused(2, &["no run found", "config.toml"]);
    fs::create_dir_all(&place.out).unwrap();
    fs::write(place.out.join("checkpoint.safetensors"), "garbage, but long enough for a header").unwrap();
    fs::write(place.out.join("config.toml"), "seed = 1").unwrap();
    dimode(&["train", "--resume", text(&place.out)]).refused(2, &["config.toml", "'data.", "is missing", "another version"]);
    fs::write(place.out.join("config.toml"), dimode(&["train", "--print-config"]).succeeded()).unwrap();
    dimode(&["train", "--resume", text(&place.out)]).refused(1, &["checkpoint.safetensors", "not a usable checkpoint"]);
    dimode(&["train", "--resume", text(&place.out), "--steps", "3"]).code_is(2);
}

#[test]
fn predictions_need_a_run_data_and_a_free_place() {
    let place = place(3);
    let infer = |run: &Path, out: &Path| dimode(&["infer", "--run", text(run), "--data", text(&place.data), "--out", text(out)]);
    infer(&place.data, &place.out).refused(2, &["no run found"]);
    infer(&place.data, &place.data).refused(2, &["already there", "fix: name a folder that is new or empty"]);
    assert!(!place.out.exists());
}

#[test]
fn depth_and_trajectories_that_cannot_be_scored() {
    let place = place(3);
    let folder = place._folder.path();
    dimode(&["eval", "depth"]).refused(2, &["nothing to score", "fix: give --run RUN"]);
    dimode(&["eval", "depth", "--gt", text(folder), "--pred", text(folder)]).refused(1, &["no PNG files"]);
    fs::write(folder.join("short.txt"), "1 0 0 0 0 1 0 0 0 0 1 0\n").unwrap();
    let odometry = |gt: &str, est: &str| dimode_in(folder, &["eval", "odometry", "--gt", gt, "--est", est]);
    odometry("none.txt", "short.txt").refused(1, &["none.txt: trajectory file not found"]);
    odometry("short.txt", "short.txt").refused(1, &["nothing to evaluate"]);
    fs::write(folder.join("words.txt"), "a b c\n").unwrap();
    odometry("words.txt", "short.txt").refused(1, &["words.txt: 3 columns"]);
}

#[test]
fn flags_of_the_other_input_are_refused() {
    let place = place(0);
    let line = "1 0 0 0 0 1 0 0 0 0 1 0\n";
    let files = ["a.txt", "b.txt"].map(|name| place.data.join(name));
    for file in &files {
        fs::write(file, line).unwrap();
    }
    let [truth, estimate] = [0, 1].map(|i: usize| text(&files[i]));
    let odometry = ["eval", "odometry", "--gt", truth, "--est", estimate];
    let depth = ["eval", "depth", "--gt", text(&place.data), "--pred", text(&place.data)];
    for (command, flag, value) in [
        (odometry, "--looks", "2"),
        (odometry, "--data", "k"),
        (odometry, "--sequences", "00"),
        (odometry, "--run", "r"),
        (depth, "--data", "k"),
        (depth, "--sequences", "00"),
        (depth, "--run", "r"),
    ] {
        let ran = dimode(&[&command[..], &[flag, value]].concat());
        ran.code_is(2);
        assert!(ran.err.contains(&format!("'{flag} <")) && ran.err.contains("cannot be used with"), "{}", ran.err);
    }
    let tolerance = dimode(&[&odometry[..], &["--max-time-difference=-1"]].concat());
    tolerance.refused(2, &["max_time_difference = -1", "0 or more"]);
}

#[test]
fn sequences_without_a_name_or_named_twice_are_refused() {
    let place = place(3);
    let out = text(&place.out);
    let train = |names: &str| dimode(&["train", "--data", text(&place.data), "--sequences", names, "--out", out]);
    train("").refused(2, &["a name is empty", "fix: name every sequence, or none to take all"]);
    train("data,data").refused(2, &["sequence data is named twice", "fix: name it once"]);
    assert!(!place.out.exists());
}

impl Ran {
    #[track_caller]
    fn code_is(&self, code: i32) {
        assert_eq!(self.code, code, "{}", self.err);
    }
}
