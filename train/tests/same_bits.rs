//! The same seed gives the same bits: on any number of threads, and when a run is killed and resumed.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

const CONFIG: &str = r#"
seed = 5
[data]
width = 64
height = 64
worlds = 6
frames = 4
[nets]
flow_iterations = 2
[train]
steps = 9
batch = 2
warmup = 2
checkpoint_every = 2
[eval]
worlds = 1
frames = 4
"#;

fn dimode(place: &Path, threads: &str, run: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_dimode"));
    command.current_dir(place).args(["train", "--threads", threads]).args(run);
    command.stdout(Stdio::null()).stderr(Stdio::null());
    command
}

fn checkpoint(place: &Path, run: &str) -> Vec<u8> {
    std::fs::read(place.join(run).join("checkpoint.safetensors")).expect("the run left a checkpoint")
}

#[test]
fn one_thread_two_threads_a_repeat_and_a_killed_run_end_in_equal_checkpoints() {
    let place = tempfile::tempdir().unwrap();
    let place = place.path();
    std::fs::write(place.join("tiny.toml"), CONFIG).unwrap();
    let fresh = |threads, out| dimode(place, threads, &["--config", "tiny.toml", "--out", out]);
    for (threads, out) in [("1", "one"), ("2", "two"), ("2", "again")] {
        assert!(fresh(threads, out).status().unwrap().success(), "{out}");
    }
    let mut child = fresh("2", "killed").spawn().unwrap();
    let log = place.join("killed/log.jsonl");
    // Checkpoints are written before the first step and after every second one.
    let steps = || std::fs::read_to_string(&log).map_or(0, |text| text.lines().count());
    let patience = Instant::now();
    while steps() < 3 && patience.elapsed() < Duration::from_secs(300) {
        std::thread::sleep(Duration::from_millis(5));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    let unfinished = !place.join("killed/metrics.json").exists();
    assert!(unfinished, "the run ended before it could be killed");
    assert!(dimode(place, "1", &["--resume", "killed"]).status().unwrap().success());
    let one = checkpoint(place, "one");
    for other in ["two", "again", "killed"] {
        assert!(checkpoint(place, other) == one, "{other} differs from one");
    }
    let steps = std::fs::read_to_string(place.join("killed/log.jsonl")).unwrap().lines().count();
    assert_eq!(steps, 9, "the log of a resumed run has every step once");
}

#[test]
fn another_seed_gives_other_bits() {
    let place = tempfile::tempdir().unwrap();
    let place = place.path();
    std::fs::write(place.join("tiny.toml"), CONFIG).unwrap();
    for (seed, out) in [("5", "five"), ("6", "six")] {
        let run = ["--config", "tiny.toml", "--steps", "2", "--seed", seed, "--out", out];
        assert!(dimode(place, "2", &run).status().unwrap().success());
    }
    assert!(checkpoint(place, "five") != checkpoint(place, "six"));
}
