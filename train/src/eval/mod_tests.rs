//! The whole evaluation: text table and JSON.

use dimode_geometry::{Se3, Trajectory};
use nalgebra::Vector3;

use super::*;
use crate::data::Map;

fn example() -> Evaluation {
    let map = |f: fn(usize) -> f32| Map { height: 4, width: 6, data: (0..24).map(f).collect() };
    let truth = map(|i| 2.0 + i as f32);
    let mut depth = DepthTableBuilder::new("dimode", DepthProtocol::default(), vec![TrivialDepth::Constant(1.0)]).unwrap();
    depth.add(&map(|i| 1.0 + 0.52 * i as f32), &truth, None).unwrap();
    let steps: Vec<Se3> = (0..50)
        .map(|i| {
            let turn = Vector3::new(0.0, 0.05 * (0.2 * f64::from(i)).sin(), 0.0);
            Se3::from_rotation_vector(&turn, Vector3::new(0.1, 0.0, -0.5))
        })
        .collect();
    let mut motion =
        MotionTableBuilder::new("dimode", OdometryProtocol::small_world(), Some(MeanMotion::fit(&steps[..20]).unwrap()));
    motion.add_sequence("a", &steps, &Trajectory::accumulate(&steps)).unwrap();
    Evaluation {
        title: "example".into(),
        data: "held-out street worlds".into(),
        depth: Some(depth.finish().unwrap()),
        motion: Some(motion.finish().unwrap()),
        notes: Vec::new(),
    }
}

#[test]
fn the_text_table_says_how_numbers_were_made() {
    let text = example().render_table();
    for part in [
        "held-out street worlds",
        "held-out street worlds, 1 frame (",
        "median scaling per image",
        "Sim(3), 7 DoF",
        "50 frame pairs in 1 sequence (",
        "constant depth",
        "zero motion",
        "mean training motion",
        "ratio to the best trivial row",
        "n/a",
        "AbsRel ↓",
        "a1 ↑",
    ] {
        assert!(text.contains(part), "{part} missing in\n{text}");
    }
    assert!(text.lines().all(|line| line.chars().count() <= 140), "{text}");
}

#[test]
fn json_keys_are_stable() {
    let json = serde_json::to_value(example()).unwrap();
    let row = &json["depth"]["rows"][0];
    for key in DepthScores::NAMES.into_iter().chain(["scale_spread", "images", "skipped", "per_image"]) {
        assert!(!row[key].is_null(), "{key}");
    }
    assert_eq!(row["kind"], "trained");
    let motion = &json["motion"]["rows"][1];
    assert!(motion["frame_to_frame"]["direction_mean_deg"].is_null());
    assert!(motion["frame_to_frame"]["rotation_mean_deg"].is_number());
    assert!(json["motion"]["rows"][0]["odometry"]["per_sequence"][0]["ate_m"].is_number());
    assert_eq!(json["motion"]["protocol"]["alignment"], "sim3");
}

#[test]
fn without_truth_the_table_says_so() {
    let empty = Evaluation { title: "x".into(), data: "my frames".into(), depth: None, motion: None, notes: Vec::new() };
    assert!(empty.render_table().contains("my frames: no ground truth"));
    assert_eq!(empty.ratio("abs_rel"), None);
    assert!(example().ratio("abs_rel").unwrap() < 0.1);
}

#[test]
fn notes_are_told_instead_of_a_table() {
    let mut noted = example();
    assert!(serde_json::to_value(&noted).unwrap().get("notes").is_none());
    (noted.depth, noted.notes) = (None, vec!["depth is not scored".to_owned()]);
    let text = noted.render_table();
    assert!(text.contains("held-out street worlds: depth is not scored") && text.contains("zero motion"), "{text}");
    assert_eq!(serde_json::to_value(&noted).unwrap()["notes"][0], "depth is not scored");
}

#[test]
fn the_ratio_needs_both_sides() {
    let rows = [("a", RowKind::Trained, Some(1.0)), ("b", RowKind::Trivial, None)];
    assert_eq!(Ratio::of("m", rows.into_iter()), None);
    let rows = [("a", RowKind::Trained, Some(1.0)), ("b", RowKind::Trivial, Some(4.0)), ("c", RowKind::Trivial, Some(2.0))];
    let got = Ratio::of("m", rows.into_iter()).unwrap();
    assert_eq!((got.best_row.as_str(), got.ratio), ("c", 0.5));
}
