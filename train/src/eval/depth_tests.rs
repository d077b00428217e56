//! Known answers, limits, and agreement with Monodepth2's evaluation.

use std::path::Path;

use safetensors::SafeTensors;

use super::*;
use crate::eval::depth_protocol::Crop;
use crate::eval::resize::{invert, resize_bilinear};

fn map(height: usize, width: usize, data: &[f32]) -> Map {
    Map { height, width, data: data.to_vec() }
}

fn unscaled() -> DepthProtocol {
    DepthProtocol { scaling: DepthScaling::None, ..DepthProtocol::default() }
}

#[test]
fn numbers_worked_by_hand() {
    let (p, g) = (map(1, 3, &[2.0, 4.0, 20.0]), map(1, 3, &[4.0, 4.0, 10.0]));
    let got = evaluate_depth_image(&unscaled(), &p, &g, None).unwrap().unwrap();
    let s = got.scores;
    assert!((s.abs_rel - 0.5).abs() < 1e-15);
    assert!((s.sq_rel - 11.0 / 3.0).abs() < 1e-15);
    assert!((s.rmse - (104.0f64 / 3.0).sqrt()).abs() < 1e-15);
    assert!((s.rmse_log - 2f64.ln() * (2.0f64 / 3.0).sqrt()).abs() < 1e-15);
    assert_eq!((s.a1, s.a2, s.a3), (1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0));
    assert_eq!((got.valid_pixels, got.scale), (3, 1.0));
}

#[test]
fn a_perfect_prediction_up_to_scale_scores_zero() {
    let g = map(2, 3, &[1.0, 2.0, 3.0, 5.0, 8.0, 0.0]);
    let p = map(2, 3, &[0.5, 1.0, 1.5, 2.5, 4.0, 99.0]);
    let got = evaluate_depth_image(&DepthProtocol::default(), &p, &g, None).unwrap().unwrap();
    assert_eq!(got.scores.values(), [0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0]);
    assert_eq!((got.scale, got.valid_pixels), (2.0, 5));
}

#[test]
fn bounds_are_strict_and_compared_in_single_precision() {
    let g = map(1, 6, &[0.0, 1e-3, 80.0, 79.99999, 85.0, 10.0]);
    let p = map(1, 6, &[1.0; 6]);
    let got = evaluate_depth_image(&unscaled(), &p, &g, None).unwrap().unwrap();
    assert_eq!(got.valid_pixels, 2);
}

#[test]
fn thresholds_are_strict() {
    let g = map(1, 2, &[1.0, 1.0]);
    let p = map(1, 2, &[1.25, 1.5625]);
    let got = evaluate_depth_image(&unscaled(), &p, &g, None).unwrap().unwrap();
    assert_eq!((got.scores.a1, got.scores.a2, got.scores.a3), (0.0, 0.5, 1.0));
}

#[test]
fn clamping_counts_what_it_changed() {
    let protocol = DepthProtocol { min_depth: 1.0, max_depth: 10.0, ..unscaled() };
    let (g, p) = (map(1, 3, &[2.0, 2.0, 9.0]), map(1, 3, &[0.5, 2.0, 11.0]));
    let got = evaluate_depth_image(&protocol, &p, &g, None).unwrap().unwrap();
    assert_eq!((got.below_min, got.above_max), (1, 1));
    assert!((got.scores.abs_rel - (0.5 + 0.0 + 1.0 / 9.0) / 3.0).abs() < 1e-15);
}

#[test]
fn the_mask_and_the_crop_select() {
    let (g, p) = (map(1, 3, &[1.0, 2.0, 4.0]), map(1, 3, &[1.0, 2.0, 9.0]));
    let mask = [true, true, false];
    let got = evaluate_depth_image(&unscaled(), &p, &g, Some(&mask)).unwrap().unwrap();
    assert_eq!((got.valid_pixels, got.scores.abs_rel), (2, 0.0));
    assert_eq!(Crop::Garg.bounds(375, 1242), [153, 371, 44, 1197]);
    assert_eq!(Crop::Garg.bounds(370, 1226), [151, 366, 44, 1181]);
    assert_eq!(Crop::Garg.bounds(376, 1241), [153, 372, 44, 1196]);
    assert_eq!(Crop::Garg.bounds(370, 1224), [151, 366, 43, 1180]);
    assert_eq!(Crop::Garg.bounds(374, 1238), [152, 370, 44, 1193]);
}

#[test]
fn the_mean_weighs_images_equally_and_skips_empty_ones() {
    let mut evaluator = DepthEvaluator::new(unscaled()).unwrap();
    let one = map(1, 2, &[1.0, 0.0]);
    evaluator.add(&map(1, 2, &[2.0, 1.0]), &one, None).unwrap();
    evaluator.add(&map(1, 2, &[1.0, 1.0]), &map(1, 2, &[1.0, 1.0]), None).unwrap();
    assert!(evaluator.add(&one.clone(), &map(1, 2, &[0.0, 0.0]), None).unwrap().is_none());
    let summary = evaluator.finish().unwrap();
    assert_eq!((summary.images, summary.skipped), (2, 1));
    assert_eq!(summary.scores.abs_rel, 0.5);
}

#[test]
fn scale_spread_is_relative_to_the_median() {
    let mut evaluator = DepthEvaluator::new(DepthProtocol::default()).unwrap();
    for value in [1.0, 2.0, 3.0] {
        evaluator.add(&map(1, 1, &[1.0]), &map(1, 1, &[value]), None).unwrap();
    }
    let summary = evaluator.finish().unwrap();
    assert_eq!(summary.scale_median, 2.0);
    assert!((summary.scale_spread - (1.0f64 / 6.0).sqrt()).abs() < 1e-15);
}

#[test]
fn errors_name_the_place() {
    let g = map(1, 2, &[1.0, 2.0]);
    let say = |p: &Map| evaluate_depth_image(&unscaled(), p, &g, None).unwrap_err().to_string();
    assert!(say(&map(1, 2, &[1.0, f32::NAN])).contains("predicted depth at row 0, column 1 is NaN"));
    assert!(say(&map(1, 2, &[-1.0, 1.0])).contains("column 0 is -1; must be positive"));
    assert!(say(&map(2, 1, &[1.0, 1.0])).contains("2x1"));
    let short = evaluate_depth_image(&unscaled(), &g, &g, Some(&[true])).unwrap_err();
    assert!(short.to_string().contains("mask"));
    let mut evaluator = DepthEvaluator::new(unscaled()).unwrap();
    evaluator.add(&g, &map(1, 2, &[0.0, 0.0]), None).unwrap();
    assert!(matches!(evaluator.finish(), Err(EvalError::NoValidPixels { images: 1 })));
    let wrong = DepthProtocol { max_depth: 0.0, ..unscaled() };
    assert!(DepthEvaluator::new(wrong).is_err());
}

const GOLDEN: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/golden/evaluation");

fn read_json(path: &Path) -> serde_json::Value {
    let text = std::fs::read_to_string(path).expect("golden file");
    serde_json::from_str(&text).expect("golden JSON")
}

fn floats(file: &SafeTensors<'_>, name: &str) -> Vec<f32> {
    let bytes = file.tensor(name).expect("golden tensor").data();
    bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
}

/// Sparse ground truth on a 64 x 208 grid.
fn sparse_truth(file: &SafeTensors<'_>, scene: &str) -> Map {
    let bytes = file.tensor(&format!("{scene}.gt_index")).expect("index").data();
    let index = bytes.chunks_exact(4).map(|b| i32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let mut truth = map(64, 208, &[0.0; 64 * 208]);
    for (i, depth) in index.zip(floats(file, &format!("{scene}.gt_depth"))) {
        truth.data[i as usize] = depth;
    }
    truth
}

fn golden_protocols() -> [(&'static str, DepthProtocol); 4] {
    let garg = DepthProtocol::kitti_eigen();
    [
        ("garg_median_80", garg),
        ("garg_lower_median_80", DepthProtocol { scaling: DepthScaling::LowerMedian, ..garg }),
        ("garg_median_80_no_clamp", DepthProtocol { clamp: false, ..garg }),
        ("median_200", DepthProtocol { max_depth: 200.0, ..DepthProtocol::default() }),
    ]
}

fn assert_matches(got: &DepthImage, want: &serde_json::Value, label: &str) {
    assert_eq!(got.valid_pixels as u64, want["n_valid"].as_u64().unwrap(), "{label}");
    let pairs = DepthScores::NAMES.into_iter().zip(got.scores.values());
    for (name, value) in pairs.chain([("ratio", got.scale)]) {
        let expected = want[name].as_f64().unwrap();
        let error = (value - expected).abs() / expected.abs().max(1e-12);
        assert!(error < 2e-5, "{label} {name}: {value} against {expected}");
    }
}

#[test]
fn depth_agrees_with_the_reference_evaluation() {
    let bytes = std::fs::read(Path::new(GOLDEN).join("depth.safetensors")).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let json = read_json(&Path::new(GOLDEN).join("depth.json"));
    for scene in ["small_0", "small_3", "small_4"] {
        let truth = sparse_truth(&file, scene);
        let disparity = map(48, 160, &floats(&file, &format!("{scene}.pred_disp")));
        let depth = invert(&resize_bilinear(&disparity, 64, 208));
        for (name, protocol) in golden_protocols() {
            let got = evaluate_depth_image(&protocol, &depth, &truth, None).unwrap().unwrap();
            assert_matches(&got, &json[name][scene], &format!("{name} {scene}"));
        }
    }
    let empty = sparse_truth(&file, "empty");
    let ones = map(64, 208, &[1.0; 64 * 208]);
    let garg = DepthProtocol::kitti_eigen();
    assert!(evaluate_depth_image(&garg, &ones, &empty, None).unwrap().is_none());
}

#[test]
fn resize_agrees_with_the_reference() {
    let bytes = std::fs::read(Path::new(GOLDEN).join("depth.safetensors")).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let json = read_json(&Path::new(GOLDEN).join("depth.json"));
    let disparity = map(48, 160, &floats(&file, "small_0.pred_disp"));
    for case in ["small_0", "small_0_down"] {
        let want = &json["resize"][case];
        let size = |i: usize| want["out"][i].as_u64().unwrap() as usize;
        let got = resize_bilinear(&disparity, size(0), size(1));
        let places = want["rows_cols"].as_array().unwrap();
        for (place, value) in places.iter().zip(want["values"].as_array().unwrap()) {
            let at = |i: usize| place[i].as_u64().unwrap() as usize;
            let (got, value) = (f64::from(got.at(at(0), at(1))), value.as_f64().unwrap());
            assert!((got - value).abs() < 1e-6 * value, "{case} {place}: {got} against {value}");
        }
    }
}
