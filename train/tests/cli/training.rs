//! Training from outside, at the smallest size: what a run leaves, stopping, continuing, failing.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use dimode::checkpoint::{Checkpoint, hash};
use dimode::data::{Map, read_depth_png, write_depth_png};
use dimode::run::{TrainedModel, open_frames};
use dimode_autodiff::Tensor;
use dimode_geometry::Trajectory;
use dimode_nets::{FlowNet, FlowNetKind, Network, ParamSet, weights};

use crate::{Ran, command, dimode, finished, text};

const TINY: [&str; 13] = [
    "--flow-weights",
    "random",
    "--size",
    "64x64",
    "--batch",
    "1",
    "--set",
    "eval.worlds=1",
    "--set",
    "eval.frames=3",
    "--set",
    "data.worlds=2",
    "--json",
];

struct Place {
    folder: tempfile::TempDir,
}

impl Place {
    fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap() }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn args(&self, name: &str, more: &[&str]) -> Vec<String> {
        let out = self.path(name);
        let all = [&["train", "--out", text(&out)], &TINY[..], more].concat();
        all.into_iter().map(str::to_owned).collect()
    }

    fn train(&self, name: &str, more: &[&str]) -> Ran {
        let args = self.args(name, more);
        dimode(&args.iter().map(String::as_str).collect::<Vec<_>>())
    }

    fn start(&self, name: &str, more: &[&str]) -> Child {
        let args = self.args(name, more);
        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        command(&args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
    }

    fn checkpoint(&self, name: &str) -> PathBuf {
        self.path(name).join("checkpoint.safetensors")
    }
}

fn step_of(checkpoint: &Path) -> u64 {
    Checkpoint::read(checkpoint).unwrap().state["step"].as_u64().unwrap()
}

#[track_caller]
pub fn wait_until(child: &mut Child, what: impl Fn() -> bool) {
    let began = Instant::now();
    while !what() && child.try_wait().unwrap().is_none() {
        assert!(began.elapsed() < Duration::from_secs(120), "waited too long");
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[cfg(unix)]
pub fn signal(child: &Child, name: &str) {
    let sent = std::process::Command::new("kill").args([name, &child.id().to_string()]).status();
    assert!(sent.unwrap().success());
}

#[test]
fn a_run_leaves_report_metrics_log_and_can_be_used() {
    let place = Place::new();
    let metrics = place.train("run", &["--steps", "2"]).succeeded();
    let metrics: serde_json::Value = serde_json::from_str(&metrics).unwrap();
    let own = metrics["depth"]["rows"][0]["abs_rel"].as_f64().unwrap();
    let run = place.path("run");
    for file in ["report.html", "metrics.json", "log.jsonl", "config.toml", "checkpoint.safetensors"] {
        assert!(run.join(file).is_file(), "{file}");
    }
    assert_eq!(fs::read_to_string(run.join("log.jsonl")).unwrap().lines().count(), 2);
    place.train("run", &["--steps", "2"]).refused(2, &["finished run is already there"]);
    let files = || ["config.toml", "metrics.json", "log.jsonl"].map(|file| fs::read(run.join(file)).unwrap());
    let before = (files(), hash(&place.checkpoint("run")).unwrap());
    for setting in ["data.frames=6000", "eval.frames=6000", "nets.pose_weights=none"] {
        assert_ne!(place.train("run", &["--force", "--set", setting]).code, 0, "{setting}");
        assert!((files(), hash(&place.checkpoint("run")).unwrap()) == before, "{setting}: the finished run stays");
    }

    let scores = dimode(&["eval", "depth", "--run", text(&run), "--json"]).succeeded();
    let scores: serde_json::Value = serde_json::from_str(&scores).unwrap();
    assert_eq!(scores["depth"]["rows"][0]["abs_rel"].as_f64().unwrap(), own, "one way to compute a number");
    let motion = |more: &[&str]| -> serde_json::Value {
        let args = [&["eval", "odometry", "--run", text(&run), "--json"], more].concat();
        serde_json::from_str::<serde_json::Value>(&dimode(&args).succeeded()).unwrap()["motion"].take()
    };
    assert_eq!(motion(&[]), metrics["motion"], "one way to compute a number");
    assert_ne!(motion(&["--looks", "1"])["rows"][0], metrics["motion"]["rows"][0]);
    dimode(&["eval", "odometry", "--run", text(&run), "--looks", "99"]).refused(2, &["nets.pose_test_iterations = 99"]);

    let on_worlds = ["eval", "odometry", "--run", text(&run)];
    let table = dimode(&on_worlds).succeeded();
    assert!(table.starts_with("Motion: synthetic-street-held-out-1, 2 frame pairs in 1 sequence ("), "{table}");
    dimode(&[&on_worlds[..], &["--sequences", "00"]].concat()).refused(2, &["embedded worlds", "fix: name a folder with --data"]);
    let report = fs::read_to_string(run.join("report.html")).unwrap().replace("&#x2f;", "/");
    assert!(report.contains(&format!("<h1>DiMoDE run: {}</h1>", run.display())));
    assert!(report.contains("Depth: synthetic-street-held-out-1, not trained on, 3 frames ("));

    let (data, out) = (place.path("frames"), place.path("predicted"));
    crate::frames(&data, 4);
    let infer = ["infer", "--run", text(&run), "--data", text(&data), "--out", text(&out), "--json"];
    let summary: serde_json::Value = serde_json::from_str(&dimode(&infer).succeeded()).unwrap();
    assert_eq!(summary[0]["frames"], 4);
    let sequence = out.join(summary[0]["name"].as_str().unwrap());
    assert_eq!(fs::read_dir(sequence.join("depth")).unwrap().count(), 4);
    assert_eq!(fs::read_dir(sequence.join("depth_magma")).unwrap().count(), 4);
    assert!(!sequence.join("flow").exists(), "flow is written on request");
    assert!(summary[0]["speed"]["depth"].as_f64().unwrap() > 0.0 && summary[0]["speed"]["flow"].is_null());
    let trajectory = fs::read_to_string(sequence.join("trajectory.kitti.txt")).unwrap();
    assert_eq!(trajectory.lines().count(), 4);

    // Depth and trajectory share one unit.
    let trained = TrainedModel::load(&run).unwrap();
    let frames = open_frames(&data, &trained.config.data, 1).unwrap();
    let mut depth = Vec::new();
    let steps = trained.walk(frames.as_ref(), 0, &mut |_, _, map| {
        depth.push(map);
        Ok(())
    });
    let path = Trajectory::accumulate(&steps.unwrap()).path_length();
    let unit = summary[0]["path_length"].as_f64().unwrap() / path;
    let mut pictures: Vec<_> = fs::read_dir(sequence.join("depth")).unwrap().map(|entry| entry.unwrap().path()).collect();
    pictures.sort();
    assert!(unit > 5.0, "{unit}: steps of 1/256 are coarse");
    for (picture, depth) in pictures.iter().zip(&depth) {
        for (written, z) in read_depth_png(picture).unwrap().data.iter().zip(&depth.data) {
            let wanted = (f64::from(*z) * unit).min(65535.0 / 256.0);
            assert!((f64::from(*written) - wanted).abs() < 0.51 / 256.0, "{written} for {wanted}");
        }
    }
    let last = Trajectory::parse_kitti(&trajectory, &sequence).unwrap().path_length();
    assert!((last / (unit * path) - 1.0).abs() < 1e-6);
    dimode(&infer).refused(2, &["predicted: already there", "fix: name a folder that is new or empty"]);
    fs::create_dir(place.path("other.partial")).unwrap();
    let beside = ["infer", "--run", text(&run), "--data", text(&data), "--out", text(&place.path("other"))].map(str::to_owned);
    dimode(&beside.each_ref().map(String::as_str)).refused(2, &["other.partial: in the way", "fix: move it away"]);
    assert!(place.path("other.partial").exists(), "what others made stays");

    let with_flow = place.path("with flow");
    let flow =
        ["infer", "--run", text(&run), "--data", text(&data), "--out", text(&with_flow), "--flow", "--formats", "flo,wheel"];
    let told = dimode(&flow).succeeded();
    assert!(told.contains("flow in full colour at ") && told.contains(", flow "), "{told}");
    let written = with_flow.join(sequence.file_name().unwrap());
    assert_eq!(fs::read_dir(written.join("flow")).unwrap().count(), 3);
    assert!(written.join("flow_legend.png").is_file() && written.join("trajectory.tum.txt").is_file());
    assert!(!written.join("depth").exists(), "only the forms that are asked for");

    let (single, out) = (place.path("single"), place.path("depth of one"));
    crate::frames(&single, 1);
    let infer = ["infer", "--run", text(&run), "--data", text(&single), "--out", text(&out), "--json"];
    let summary: serde_json::Value = serde_json::from_str(&dimode(&infer).succeeded()).unwrap();
    assert_eq!(summary[0]["frames"], 1, "a single picture has a depth, too");
}

#[test]
fn own_frames_train_without_any_truth() {
    let place = Place::new();
    let data = place.path("frames");
    crate::frames(&data, 5);
    place.train("run", &["--steps", "1", "--data", text(&data)]).succeeded();
    assert!(place.path("run/report.html").is_file());
}

#[cfg(unix)]
#[test]
fn interrupted_and_killed_runs_continue_with_the_same_bits() {
    let place = Place::new();
    let steps = ["--steps", "6", "--set", "train.checkpoint_every=2"];
    place.train("whole", &[&steps[..], &["--threads", "2"]].concat()).succeeded();
    for (name, how) in [("interrupted", "-INT"), ("killed", "-KILL")] {
        let mut child = place.start(name, &[&steps[..], &["--threads", "1"]].concat());
        let checkpoint = place.checkpoint(name);
        let enough = if how == "-INT" { 1 } else { 3 };
        wait_until(&mut child, || child_log(&place, name) >= enough);
        signal(&child, how);
        let status = child.wait().unwrap();
        if how == "-INT" {
            // The signal may come after the last step, which is a normal end.
            assert!(matches!(status.code(), Some(130 | 0)), "{status}");
        }
        let run = place.path(name);
        dimode(&["train", "--resume", text(&run), "--json"]).succeeded();
        assert_eq!(hash(&checkpoint).unwrap(), hash(&place.checkpoint("whole")).unwrap(), "{name}");
        assert_eq!(child_log(&place, name), 6);
    }
}

fn child_log(place: &Place, name: &str) -> usize {
    fs::read_to_string(place.path(name).join("log.jsonl")).map_or(0, |text| text.lines().count())
}

#[cfg(unix)]
#[test]
fn ctrl_c_saves_and_ends_with_130() {
    let place = Place::new();
    let mut child = place.start("run", &["--steps", "100000"]);
    wait_until(&mut child, || child_log(&place, "run") >= 1);
    signal(&child, "-INT");
    let ran = finished(child.wait_with_output().unwrap());
    assert_eq!(ran.code, 130, "{}", ran.err);
    assert!(ran.err.contains("finishing this step") && ran.err.contains("--resume"), "{}", ran.err);
    assert_eq!(step_of(&place.checkpoint("run")), child_log(&place, "run") as u64);
    assert!(!place.path("run/metrics.json").exists());
}

#[cfg(unix)]
#[test]
fn a_full_disk_leaves_no_half_checkpoint() {
    if !Path::new("/dev/full").exists() {
        eprintln!("skipped: no /dev/full here");
        return;
    }
    let place = Place::new();
    let run = place.path("run");
    fs::create_dir(&run).unwrap();
    let settings = place.train("run", &["--steps", "1", "--print-config"]).succeeded();
    fs::write(run.join("config.toml"), format!("# dimode train\n\n{settings}")).unwrap();
    std::os::unix::fs::symlink("/dev/full", run.join(".checkpoint.safetensors.dimode.tmp")).unwrap();
    place.train("run", &["--steps", "1"]).refused_after_notes(1, &["checkpoint.safetensors", "free some space"]);
    for file in ["checkpoint.safetensors", "config.toml", "log.jsonl"] {
        assert!(!run.join(file).exists(), "{file} of a run that could not begin is left");
    }
}

#[cfg(unix)]
#[test]
fn ctrl_c_ends_the_evaluation_too() {
    let place = Place::new();
    let mut child = place.start("run", &["--steps", "1", "--set", "eval.worlds=2000"]);
    wait_until(&mut child, || place.path("run/trajectories").exists());
    signal(&child, "-INT");
    let ran = finished(child.wait_with_output().unwrap());
    assert_eq!(ran.code, 130, "{}", ran.err);
    assert!(ran.err.contains("--resume"), "{}", ran.err);
    assert_eq!(step_of(&place.checkpoint("run")), 1);
    assert!(!place.path("run/metrics.json").exists());
}

#[test]
fn flow_weights_that_do_not_fit_are_refused_before_anything_is_written() {
    let place = Place::new();
    let file = place.path("flow.safetensors");
    fs::write(&file, "not weights").unwrap();
    let run = place.path("run");
    let flags = ["train", "--out", text(&run), "--flow-weights", text(&file)];
    dimode(&flags).refused(1, &["flow.safetensors", "fix: name a file that 'dimode pretrain flow' wrote"]);
    assert!(!place.path("run").exists());
}

#[test]
fn flow_weights_that_are_not_finite_are_refused_by_name() {
    let place = Place::new();
    let file = place.path("flow.safetensors");
    let mut weights: ParamSet<f32> = FlowNet::new(FlowNetKind::NanoRaftD4.config()).init(1);
    let (_, entry) = weights.file_mut("raft").iter_mut().next().unwrap();
    entry.set(Tensor::full(entry.tensor().shape(), f32::NAN));
    weights::save(&file, weights.file("raft").unwrap()).unwrap();
    let run = place.path("run");
    let flags = ["train", "--out", text(&run), "--flow-weights", text(&file)];
    dimode(&flags).refused(1, &["flow.safetensors", ".weight' holds NaN", "fix: name a file that 'dimode pretrain flow' wrote"]);
    assert!(!run.exists());
}

#[test]
fn pose_weights_that_do_not_fit_are_refused_before_anything_is_written() {
    let place = Place::new();
    let folder = place.path("pose");
    fs::create_dir(&folder).unwrap();
    fs::write(folder.join("pose_encoder.safetensors"), "not weights").unwrap();
    let run = place.path("run");
    let flags = ["train", "--out", text(&run), "--pose-weights", text(&folder)];
    dimode(&flags).refused(1, &["pose weights not found", "fix: check nets.pose_weights: a folder with pose.safetensors"]);
    fs::write(folder.join("pose.safetensors"), "not weights").unwrap();
    dimode(&flags).refused(1, &["pose_encoder.safetensors", "fix: name a folder that 'dimode pretrain pose' wrote"]);
    assert!(!place.path("run").exists());
}

#[test]
fn a_pre_trained_pose_network_starts_a_run() {
    let place = Place::new();
    let folder = place.path("pose");
    let flags = ["--steps", "2", "--batch", "2", "--size", "64x64", "--preset-mix", "handheld", "--json"];
    let ran = dimode(&[&["pretrain", "pose", "--out", text(&folder)][..], &flags].concat());
    let errors: serde_json::Value = serde_json::from_str(&ran.succeeded()).unwrap();
    assert_eq!(errors[0]["preset"], "handheld");
    assert!(errors[0]["zero"].as_f64().unwrap() > 1.0);
    place.train("one", &["--steps", "1", "--pose-weights", text(&folder)]).succeeded();
    fs::remove_dir_all(&folder).unwrap();
    dimode(&["train", "--resume", text(&place.path("one")), "--json"]).succeeded();
    place.train("other", &["--steps", "1"]).succeeded();
    let hash_of = |run| hash(&place.checkpoint(run)).unwrap();
    assert_ne!(hash_of("one"), hash_of("other"));
}

#[test]
fn the_pose_rate_is_the_pose_networks_alone() {
    let place = Place::new();
    let one_step = ["--steps", "1", "--set", "train.warmup=0", "--set"];
    place.train("slow", &[&one_step[..], &["train.pose_rate=0.2"]].concat()).succeeded();
    place.train("full", &[&one_step[..], &["train.pose_rate=1"]].concat()).succeeded();
    let [slow, full] = ["slow", "full"].map(|run| Checkpoint::read(&place.checkpoint(run)).unwrap().tensors);
    for network in ["depth/", "flow/", "pose/"] {
        let of = |tensors: &[(String, Vec<usize>, dimode_autodiff::Tensor<f32>)]| -> Vec<Vec<f32>> {
            tensors.iter().filter(|(name, ..)| name.starts_with(network)).map(|(_, _, values)| values.to_vec()).collect()
        };
        assert!(!of(&slow).is_empty(), "{network}");
        assert_eq!(of(&slow) == of(&full), network != "pose/", "{network}");
    }
}

/// Rates that end in weights which are not finite, in weights of which the next step cannot make anything, and in weights
/// which are found out when they are to be saved.
#[test]
fn values_that_are_not_finite_stop_the_run_and_keep_the_last_good_checkpoint() {
    let place = Place::new();
    for (name, steps, rate) in [("endless", "1", "1e38"), ("huge", "9", "1e30"), ("wild", "9", "1e15"), ("last", "1", "1e5")] {
        let wild = ["--steps", steps, "--learning-rate", rate, "--set", "train.warmup=0"];
        place.train(name, &wild).refused_after_notes(1, &[name, "step ", "not finite", "sample", "fix: ", "--resume", "--force"]);
        let Checkpoint { tensors, state } = Checkpoint::read(&place.checkpoint(name)).unwrap();
        assert_eq!(state["step"], 0, "{name}");
        for (tensor, _, values) in &tensors {
            assert!(values.data().iter().all(|value| value.abs() < 1e6), "{name}: {tensor}");
        }
        assert!(!place.path(name).join("metrics.json").exists());
    }
    // As the error says: a lower rate, then on.
    let config = place.path("endless/config.toml");
    let text_there = fs::read_to_string(&config).unwrap();
    let line = text_there.lines().find(|line| line.starts_with("learning_rate")).unwrap();
    fs::write(&config, text_there.replace(line, "learning_rate = 0.001")).unwrap();
    dimode(&["train", "--resume", text(&place.path("endless")), "--json"]).succeeded();
    assert_eq!(step_of(&place.checkpoint("endless")), 1);
}

/// A folder in KITTI layout whose depth pictures know no pixel.
#[test]
fn depth_that_cannot_be_scored_is_told_in_a_finished_run() {
    let place = Place::new();
    let (worlds, run) = (place.path("worlds"), place.path("run"));
    dimode(&["synth", "--worlds", "1", "--frames", "4", "--size", "64x64", "--out", text(&worlds)]).succeeded();
    for picture in fs::read_dir(worlds.join("depth/00")).unwrap() {
        write_depth_png(&picture.unwrap().path(), &Map::zeros(64, 64)).unwrap();
    }
    let metrics = place.train("run", &["--steps", "1", "--data", text(&worlds)]).succeeded();
    let metrics: serde_json::Value = serde_json::from_str(&metrics).unwrap();
    assert!(metrics["depth"].is_null() && metrics["motion"].is_object());
    assert!(metrics["notes"][0].as_str().unwrap().contains("depth is not scored: none of the 4 images"), "{}", metrics["notes"]);
    let report = fs::read_to_string(run.join("report.html")).unwrap();
    assert!(report.contains("depth is not scored"));
}

impl Ran {
    /// As `refused`, but the error comes after lines about the work.
    #[track_caller]
    fn refused_after_notes(mut self, code: i32, parts: &[&str]) {
        let at = self.err.find("error: ").unwrap_or_else(|| panic!("no error is told: {}", self.err));
        self.err.drain(..at);
        self.refused(code, parts);
    }
}
