use std::path::Path;

use dimode_geometry::losses::LossOptions;

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
    config.data.camera = Some(crate::data::KittiCamera::RightColour);
    config.data.center_crop = true;
    config.nets.flow_weights = FirstWeights::File("flow.safetensors".into());
    config.loss.geometric = LossOptions::literal();
    config.train.only_stages = Some(vec![1, 3]);
    assert_eq!(parse(&config.to_toml()).unwrap(), config);
}

/// What runs are made with: a name or a number that changes here makes their folders mean something else.
#[test]
fn the_geometric_losses_have_one_set_of_names_and_defaults() {
    let text = r#"
        convention = "consistent"
        planar = "perpendicular-pixels"
        axial = "perpendicular-pixels"
        tangential = "flow-pixels"
        radial = "flow-pixels"
        static_mask = "relative"
        tau_flow = 0.1
        tau_ratio = 0.1
        q_min = 1.0
        gate = 2.0
        tau_translation = 0.001
        kappa = 0.05
        axes = [true, true, true]
        min_tangential_flow = 0.5
        min_tangential_share = 0.3
        smooth_pixels = 0.0
        noise_pixels = 0.5
        noise_share = 0.15
        min_valid_share = 0.1
        z_min = 0.001
        detach_source_depth = true
        detach_direction = false
    "#;
    assert_eq!(toml::Table::try_from(LossOptions::default()).unwrap(), text.parse().unwrap());
    assert_eq!(Config::default().loss.geometric, LossOptions::default());
}

#[test]
fn unknown_key_names_line_and_nearest_key() {
    let message = refusal("seed = 3\n[train]\nbatch = 2\nstpes = 10\n");
    assert_eq!(message, "run.toml:4: unknown key 'stpes'; did you mean 'steps'?");
}

#[test]
fn key_of_another_table_is_named_with_its_table() {
    for (text, meant) in [
        ("learning_rate = 0.1\n", "train.learning_rate"),
        ("lerning_rate = 0.1\n", "train.learning_rate"),
        ("only_stages = [1]\n", "train.only_stages"),
        ("onlystages = [1]\n", "train.only_stages"),
        ("[train]\nonly_stage = [1]\n", "only_stages"),
        ("path = \"frames\"\n", "data.path"),
        ("[train]\npath = \"frames\"\n", "data.path"),
        ("[data]\npaht = \"frames\"\n", "path"),
    ] {
        let message = refusal(text);
        assert!(message.ends_with(&format!("; did you mean '{meant}'?")), "{message}");
    }
}

#[test]
fn unset_settings_are_shown_as_comments() {
    let text = Config::default().to_toml();
    let comments: Vec<&str> = text.lines().filter(|line| line.starts_with("# ")).collect();
    assert!(comments[0].starts_with("# path = \"frames\"  # folder of real frames"), "{comments:?}");
    assert!(comments[1].starts_with("# folder = \"teacher\"  # folder of pseudo-depth maps"), "{comments:?}");
    assert!(comments[2].starts_with("# only_stages = [1, 2]  # train only these stages"), "{comments:?}");
    assert_eq!((comments.len(), parse(&text).unwrap()), (3, Config::default()));
    let uncommented = parse(&text.replace("\n# ", "\n")).unwrap();
    assert_eq!(uncommented.data.path.as_deref(), Some(Path::new("frames")));
    assert_eq!(uncommented.loss.local_structure.folder.as_deref(), Some(Path::new("teacher")));
    assert_eq!(uncommented.train.only_stages, Some(vec![1, 2]));
    assert!(!uncommented.to_toml().contains('#'));
}

#[test]
fn groups_that_do_not_go_together_are_refused() {
    let refused = |text: &str| parse(text).unwrap().validate().unwrap_err().to_string();
    let message = refused("[nets]\nrectify = \"nano\"\n");
    assert!(message.starts_with("nets.rectify = nano: the optical flow knows nothing of the removed rotation"), "{message}");
    parse("[nets]\nrectify = \"nano\"\n[loss]\npreset = \"sc-depth\"\n").unwrap().validate().unwrap();
    let text = "[loss.local_structure]\npseudo_depth = \"rendered\"\n";
    parse(text).unwrap().validate().unwrap();
    let message = refused(&format!("[loss]\npreset = \"monodepth2\"\n{text}"));
    assert!(message.starts_with("loss.local_structure.pseudo_depth = rendered: no stage has lambda3 above 0"), "{message}");
    let message = refused("[loss]\nocclusion = \"best-matches\"\n[data]\nwidth = 640\nheight = 192\n");
    assert!(message.starts_with("loss.geometric.min_valid_share = 0.1: best-matches leaves at most 0.016"), "{message}");
    let message = refused(&format!("[data]\npath = \"frames\"\n{text}"));
    assert!(message.contains("only the embedded world is rendered"), "{message}");
    let message = refused("[loss.local_structure]\npseudo_depth = \"folder\"\n");
    assert!(message.starts_with("loss.local_structure.folder = none: name the folder of the maps"), "{message}");
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
    let message = refusal("[data]\ncamera = \"left-color\"\n");
    assert_eq!(message, "run.toml:2: unknown value 'left-color'; did you mean 'left-colour'?");
    let message = refusal("[nets]\ndepth = \"resnet99\"\n");
    assert!(message.contains("run.toml:2") && message.contains("nano_resnet"), "{message}");
}

#[test]
fn values_of_the_wrong_kind_name_line_key_and_kind() {
    for (text, told) in [
        ("seed = \"one\"", "1: seed must be a whole number, 0 or more; write for instance seed = 1"),
        ("[train]\nsteps = -3", "2: train.steps must be a whole number, 0 or more; write for instance train.steps = 3600"),
        ("[train]\nlearning_rate = \"x\"", "2: train.learning_rate must be a number; "),
        ("[train]\nflip = 3", "2: train.flip must be true or false; write for instance train.flip = true"),
        ("[train]\nonly_stages = 1", "2: train.only_stages must be a list of whole numbers; "),
        ("[train]\nbetas = [0.9]", "2: train.betas must be a list of numbers; write for instance train.betas = [0.9, 0.999]"),
        ("train = 3", "1: train must be a table; set what is in it, for instance train."),
        ("[data]\npath = 3", "2: data.path must be a text; "),
        ("[data]\npreset = 3", "2: data.preset must be a text; "),
        ("[data]\nsequences = [1]", "2: data.sequences must be a list of texts; "),
        ("[nets]\ndepth = 3", "2: nets.depth must be a text; "),
        ("[[train.stages]]\nname = \"a\"\nshare = \"x\"", "3: train.stages.share must be a number; "),
        ("[[train.stages]]\nname = \"a\"", "1: 'share' is missing in train.stages; add it"),
    ] {
        let message = refusal(text);
        assert!(message.starts_with(&format!("run.toml:{told}")), "{message}");
        let table: toml::Table = toml::from_str(text).unwrap();
        let message = Config::from_table(table, "--set").unwrap_err().to_string();
        let (_, told) = told.split_once(": ").unwrap();
        assert!(message.starts_with(&format!("--set: {told}")), "{message}");
    }
}

#[test]
fn broken_toml_names_the_line() {
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
    check(|c| c.data.frames = 5001, "data.frames = 5001");
    check(|c| c.eval.frames = 5001, "eval.frames = 5001");
    check(|c| c.nets.max_depth = 0.05, "nets.max_depth = 0.05");
    check(|c| c.loss.scales = 5, "loss.scales = 5");
    check(|c| c.loss.geometric.kappa = -1.0, "loss.geometric.kappa = -1");
    check(|c| c.eval.max_depth = f64::INFINITY, "eval.max_depth = inf");
}
