use std::fs;

use crate::{dimode, text};

#[test]
fn the_truth_scores_perfectly_against_itself() {
    let place = tempfile::tempdir().unwrap();
    let worlds = place.path().join("worlds");
    let size = ["--preset", "handheld", "--worlds", "1", "--frames", "12", "--size", "48x32"];
    dimode(&[&["synth", "--out", text(&worlds)][..], &size].concat()).succeeded();
    let poses = worlds.join("poses/00.txt");
    let odometry = ["eval", "odometry", "--gt", text(&poses), "--est", text(&poses), "--lengths", "0.2", "--start-step", "1"];
    let scores = dimode(&[&odometry[..], &["--align", "none", "--json"]].concat()).succeeded();
    let scores: serde_json::Value = serde_json::from_str(&scores).unwrap();
    assert_eq!(scores["protocol"]["alignment"], "none");
    assert_eq!(scores["errors"]["frames"], 12);
    assert!(scores["errors"]["ate_m"].as_f64().unwrap() < 1e-9);
    let table = dimode(&[&odometry[..], &["--align", "7dof"]].concat()).succeeded();
    assert!(table.contains("Sim(3), 7 DoF") && table.contains("ATE"), "{table}");
}

#[test]
fn a_scaled_prediction_is_perfect_only_after_scaling() {
    use dimode::data::{Map, write_depth_png};
    let place = tempfile::tempdir().unwrap();
    let (gt, pred) = (place.path().join("gt"), place.path().join("pred"));
    for (folder, factor) in [(&gt, 1.0), (&pred, 0.5)] {
        fs::create_dir(folder).unwrap();
        let values = (0..12).map(|i| factor * (4.0 + 2.0 * i as f32)).collect();
        write_depth_png(&folder.join("000000.png"), &Map::from_vec(3, 4, values)).unwrap();
    }
    let score = |scaling: &str| -> f64 {
        let args = ["eval", "depth", "--gt", text(&gt), "--pred", text(&pred), "--scaling", scaling, "--json"];
        let scores: serde_json::Value = serde_json::from_str(&dimode(&args).succeeded()).unwrap();
        scores["depth"]["rows"][0]["abs_rel"].as_f64().unwrap()
    };
    assert!(score("median") < 1e-9);
    assert!((score("none") - 0.5).abs() < 1e-9);
    let table = dimode(&["eval", "depth", "--gt", text(&gt), "--pred", text(&pred)]).succeeded();
    assert!(table.contains("constant"), "the trivial row stands beside it: {table}");
}

#[test]
fn a_named_protocol_is_used_and_single_flags_change_it() {
    use dimode::data::{Map, write_depth_png};
    let place = tempfile::tempdir().unwrap();
    let folder = place.path().join("depth");
    fs::create_dir(&folder).unwrap();
    write_depth_png(&folder.join("000000.png"), &Map::from_vec(30, 40, vec![5.0; 1200])).unwrap();
    let protocol = |flags: &[&str]| -> serde_json::Value {
        let scored = ["eval", "depth", "--gt", text(&folder), "--pred", text(&folder), "--json"];
        let printed = dimode(&[&scored[..], flags].concat()).succeeded();
        serde_json::from_str::<serde_json::Value>(&printed).unwrap()["depth"]["protocol"].clone()
    };
    let eigen = ["--protocol", "kitti-eigen"];
    assert_eq!(protocol(&[])["crop"], "none");
    assert_eq!(protocol(&eigen)["crop"], "garg");
    let changed = protocol(&[&eigen[..], &["--max-depth", "50"]].concat());
    assert_eq!((changed["crop"].as_str(), changed["max_depth"].as_f64()), (Some("garg"), Some(50.0)));
    assert_eq!(protocol(&[&eigen[..], &["--crop", "none"]].concat())["crop"], "none");
}
