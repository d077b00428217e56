use std::path::Path;

use super::*;

fn parse(text: &str) -> Result<Config, ConfigError> {
    Config::from_toml(text, Path::new("run.toml"))
}

fn refusal(text: &str) -> String {
    parse(text).unwrap_err().to_string()
}

#[test]
fn an_empty_file_is_the_default() {
    assert_eq!(parse("").unwrap(), Config::default());
    Config::default().validate().unwrap();
    Config::quick().validate().unwrap();
}

#[test]
fn writing_and_reading_gives_the_same_configuration() {
    let mut config = Config::quick();
    config.data.path = Some("frames/a b".into());
    config.nets.flow_weights = FirstWeights::File("flow.safetensors".into());
    config.loss.geometric = GeometricConfig::literal();
    config.train.only_stages = Some(vec![1, 3]);
    assert_eq!(parse(&config.to_toml()).unwrap(), config);
}

#[test]
fn unknown_key_names_line_and_nearest_key() {
    let message = refusal("seed = 3\n[train]\nbatch = 2\nstpes = 10\n");
    assert_eq!(message, "run.toml:4: unknown key 'stpes'; did you mean 'steps'?");
}

#[test]
fn key_of_another_table_is_named_with_its_table() {
    let message = refusal("learning_rate = 0.1\n");
    assert!(message.contains("did you mean 'train.learning_rate'?"), "{message}");
}

#[test]
fn unknown_key_without_resemblance_lists_what_exists() {
    let message = refusal("[eval]\nqqqqqqqq = 1\n");
    assert!(message.contains("known here: worlds, frames"), "{message}");
}

#[test]
fn unknown_names_of_choices_are_refused_with_the_nearest() {
    let message = refusal("[data]\npreset = \"steet\"\n");
    assert_eq!(message, "run.toml:2: unknown value 'steet'; did you mean 'street'?");
    let message = refusal("[nets]\ndepth = \"resnet99\"\n");
    assert!(message.contains("run.toml:2") && message.contains("nano_resnet"), "{message}");
}

#[test]
fn wrong_types_and_broken_toml_name_the_line() {
    assert!(refusal("seed = \"one\"").starts_with("run.toml:1: "));
    assert!(refusal("seed = 1\n[train\n").starts_with("run.toml:2: "));
}

#[test]
fn stages_have_the_printed_weights() {
    for stages in [StageConfig::paper(), StageConfig::nano()] {
        let weights: Vec<_> = stages.iter().map(|s| (s.lambda1, s.lambda2, s.lambda3, s.train_flow)).collect();
        assert_eq!(weights, [(0.0, 0.0, 0.01, true), (0.05, 0.0, 0.01, false), (0.05, 0.1, 0.01, false)]);
        let total: f64 = stages.iter().map(|s| s.share).sum();
        assert!((total - 1.0).abs() < 1e-12);
    }
}

#[test]
fn ranges_are_checked_and_the_key_is_named() {
    let check = |change: fn(&mut Config), key: &str| {
        let mut config = Config::default();
        change(&mut config);
        let message = config.validate().unwrap_err().to_string();
        assert!(message.starts_with(key), "{message}");
    };
    check(|c| c.train.steps = 0, "train.steps = 0");
    check(|c| c.train.batch = 0, "train.batch = 0");
    check(|c| c.train.learning_rate = f64::NAN, "train.learning_rate = NaN");
    check(|c| c.train.betas = [0.9, 1.0], "train.betas = 1");
    check(|c| c.train.only_stages = Some(vec![4]), "train.only_stages = [4]");
    check(|c| c.train.only_stages = Some(vec![2, 1]), "train.only_stages = [2, 1]");
    check(|c| c.train.stages.clear(), "train.stages = 0");
    check(|c| c.data.width = 100, "data.width = 100");
    check(|c| c.data.frames = 2, "data.frames = 2");
    check(|c| c.nets.max_depth = 0.05, "nets.max_depth = 0.05");
    check(|c| c.loss.scales = 5, "loss.scales = 5");
    check(|c| c.loss.geometric.kappa = -1.0, "loss.geometric.kappa = -1");
    check(|c| c.eval.max_depth = f64::INFINITY, "eval.max_depth = inf");
}
