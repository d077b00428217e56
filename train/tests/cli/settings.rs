use std::fs;

use crate::{dimode, text};

#[test]
fn flags_win_over_the_file_and_the_file_over_defaults() {
    let place = tempfile::tempdir().unwrap();
    let file = place.path().join("my.toml");
    fs::write(&file, "seed = 5\n[train]\nsteps = 77\nbatch = 3\n").unwrap();
    let printed = dimode(&["train", "--config", text(&file), "--steps", "9", "--print-config"]).succeeded();
    let config = dimode::config::Config::from_toml(&printed, &file).unwrap();
    assert_eq!((config.seed, config.train.steps, config.train.batch), (5, 9, 3));
    assert_eq!(config.data, dimode::config::DataConfig::default());
}

#[test]
fn the_printed_settings_are_a_complete_file() {
    let place = tempfile::tempdir().unwrap();
    let file = place.path().join("my.toml");
    let printed = dimode(&["train", "--quick", "--preset", "handheld", "--print-config"]).succeeded();
    fs::write(&file, &printed).unwrap();
    assert_eq!(dimode(&["train", "--config", text(&file), "--print-config"]).succeeded(), printed);
}

#[test]
fn unknown_keys_are_refused_with_the_nearest_known_one() {
    let place = tempfile::tempdir().unwrap();
    let file = place.path().join("my.toml");
    fs::write(&file, "[train]\nlerning_rate = 0.1\n").unwrap();
    let ran = dimode(&["train", "--config", text(&file), "--out", text(&place.path().join("run"))]);
    ran.refused(2, &["my.toml:2", "unknown key 'lerning_rate'", "fix: did you mean 'learning_rate'?"]);
    assert!(!place.path().join("run").exists());
}

#[test]
fn values_out_of_range_are_refused() {
    dimode(&["train", "--steps", "0", "--print-config"]).refused(2, &["train.steps = 0"]);
    dimode(&["train", "--size", "100x64", "--print-config"]).refused(2, &["data.width = 100", "multiple of 32"]);
    dimode(&["train", "--stages", "1,7", "--print-config"]).refused(2, &["train.only_stages"]);
    dimode(&["train", "--set", "train.warmpu=3", "--print-config"]).refused(2, &["did you mean 'warmup'?"]);
}

#[test]
fn values_of_the_wrong_kind_are_refused_with_an_example() {
    let kind = ["train.steps must be a whole number, 0 or more", "fix: write for instance train.steps = 3600"];
    dimode(&["train", "--set", "train.steps=x", "--print-config"]).refused(2, &kind);
    dimode(&["train", "--set", "train=3", "--print-config"]).refused(2, &["train must be a table", "fix: set what is in it"]);
}

#[test]
fn a_missing_configuration_file_is_named() {
    dimode(&["train", "--config", "no-such.toml"]).refused(2, &["no-such.toml", "--config"]);
}

#[test]
fn a_full_disk_behind_standard_output_is_a_failure() {
    let Ok(full) = fs::File::options().write(true).open("/dev/full") else {
        eprintln!("skipped: no /dev/full here");
        return;
    };
    let output = crate::command(&["train", "--print-config"]).stdout(full).output().unwrap();
    let ran = crate::finished(output);
    ran.refused(1, &["No space left"]);
}
