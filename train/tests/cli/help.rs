use std::io::Read;
use std::process::Stdio;

use crate::{command, dimode};

#[test]
fn the_top_teaches_the_commands_and_exit_codes() {
    let help = dimode(&["--help"]).succeeded();
    for word in [
        "train",
        "eval",
        "infer",
        "synth",
        "pretrain",
        "verify",
        "cost",
        "weights",
        "Examples:",
        "dimode train --quick",
        "130 interrupted",
    ] {
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
        &["verify"],
        &["cost"],
        &["weights", "inspect"],
        &["weights", "convert"],
        &["weights", "diff"],
    ] {
        let help = dimode(&[words, &["--help"]].concat()).succeeded();
        assert!(help.contains("Examples:\n"), "{words:?}: {help}");
        assert!(help.contains(&format!("dimode {}", words.join(" "))), "{words:?}: {help}");
        assert!(help.contains("--threads"), "{words:?}: {help}");
    }
}

/// The words of a text, whatever its line breaks are.
fn words(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[test]
fn long_help_explains_the_command() {
    for (command, sentence) in [
        (&["train"][..], "Without --data the frames come from an embedded world that is rendered while training runs"),
        (&["eval", "depth"], "Scale is found per image by the ratio of medians unless --scaling says otherwise."),
        (&["eval", "odometry"], "Frames are matched by index, or by time when both files hold times."),
        (&["infer"], "from a single camera its length is not known."),
        (&["synth"], "The folder can be given to 'dimode train --data'."),
        (&["pretrain", "flow"], "Every step renders new worlds, so no pair is seen twice."),
        (&["pretrain", "pose"], "No true depth or motion of a world is used"),
        (&["cost"], "Pose and flow networks look at a pair of frames."),
        (&["verify"], "The code is 1 when a verdict does not stand."),
        (&["weights", "inspect"], "Nothing in a file is ever executed"),
        (&["weights", "convert"], "otherwise all differences are listed and nothing is written."),
        (&["weights", "diff"], "The code is 0 when they are equal within the tolerance and 1 when not."),
    ] {
        let by_flag = words(&dimode(&[command, &["--help"]].concat()).succeeded());
        assert!(by_flag.contains(sentence), "{command:?}: {by_flag}");
        let by_name = words(&dimode(&[&["help"], command].concat()).succeeded());
        assert!(by_name.contains(sentence), "{command:?}: {by_name}");
        let short = words(&dimode(&[command, &["-h"]].concat()).succeeded());
        assert!(!short.contains(sentence), "{command:?}: {short}");
    }
}

#[test]
fn lists_of_commands_say_what_each_does() {
    let eval = words(&dimode(&["eval", "--help"]).succeeded());
    assert!(eval.contains("odometry Score motion against ground truth: of a trained run, or of a trajectory file"), "{eval}");
    let top = words(&dimode(&["--help"]).succeeded());
    assert!(top.contains("synth Render embedded worlds to a folder in KITTI odometry layout"), "{top}");
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
