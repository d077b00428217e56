use std::io::Read;
use std::process::Stdio;

use crate::{command, dimode};

#[test]
fn the_top_teaches_the_commands_and_exit_codes() {
    let help = dimode(&["--help"]).succeeded();
    for word in ["train", "eval", "infer", "synth", "pretrain", "Examples:", "dimode train --quick", "130 interrupted"] {
        assert!(help.contains(word), "'{word}' is not in: {help}");
    }
    assert!(dimode(&["--version"]).succeeded().starts_with("dimode "));
}

#[test]
fn every_command_has_examples() {
    for words in [
        &["train"][..],
        &["eval", "depth"],
        &["eval", "odometry"],
        &["infer"],
        &["synth"],
        &["pretrain", "flow"],
        &["pretrain", "pose"],
    ] {
        let help = dimode(&[words, &["--help"]].concat()).succeeded();
        assert!(help.contains("Examples:\n"), "{words:?}: {help}");
        assert!(help.contains(&format!("dimode {}", words.join(" "))), "{words:?}: {help}");
        assert!(help.contains("--threads"), "{words:?}: {help}");
    }
}

#[test]
fn train_help_names_its_main_flags() {
    let help = dimode(&["train", "--help"]).succeeded();
    for flag in [
        "--config", "--data", "--preset", "--quick", "--steps", "--batch", "--seed", "--stages", "--out", "--resume", "--json",
        "--size", "--loss",
    ] {
        assert!(help.contains(flag), "{flag}");
    }
}

#[test]
fn wrong_flags_end_with_2() {
    for args in [&["train", "--stpes", "3"][..], &["fly"], &[], &["train", "--preset", "moon"], &["train", "--threads", "0"]] {
        let ran = dimode(args);
        assert_eq!(ran.code, 2, "{args:?}: {}", ran.err);
        assert_eq!(ran.out, "");
    }
    assert!(dimode(&["train", "--stpes", "3"]).err.contains("--steps"), "the nearest flag is named");
}

#[test]
fn a_closed_pipe_is_a_normal_end() {
    let mut child = command(&["train", "--print-config"]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    let mut told = String::new();
    child.stderr.take().unwrap().read_to_string(&mut told).unwrap();
    assert_eq!((child.wait().unwrap().code(), told.as_str()), (Some(0), ""));
}
