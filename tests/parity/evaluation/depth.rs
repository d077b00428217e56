//! Depth metrics and the resize, against a program in NumPy.

use dimode::data::Map;
use dimode::eval::{DepthImage, DepthProtocol, DepthScaling, DepthScores, evaluate_depth_image, resize_bilinear, resize_depth};
use dimode_tests::{Golden, json};
use serde_json::Value;

/// Numbers of rows and columns of the ground truth and of the prediction.
const TRUTH: [usize; 2] = [64, 208];
const PREDICTION: [usize; 2] = [48, 160];

fn open() -> (Golden, Value) {
    (Golden::open("evaluation/depth.safetensors"), json("evaluation/depth.json"))
}

fn map([height, width]: [usize; 2], values: impl Iterator<Item = f64>) -> Map {
    Map { height, width, data: values.map(|v| v as f32).collect() }
}

fn sparse_truth(golden: &Golden, scene: &str) -> Map {
    let mut values = vec![0.0; TRUTH[0] * TRUTH[1]];
    let depths = golden.numbers(&format!("{scene}.gt_depth"));
    for (&i, &depth) in golden.numbers(&format!("{scene}.gt_index")).iter().zip(depths) {
        values[i as usize] = depth;
    }
    map(TRUTH, values.into_iter())
}

fn disparity<'a>(golden: &'a Golden, scene: &str) -> impl Iterator<Item = f64> + use<'a> {
    golden.numbers(&format!("{scene}.pred_disp")).iter().copied()
}

fn protocols() -> [(&'static str, DepthProtocol); 4] {
    let garg = DepthProtocol::kitti_eigen();
    [
        ("garg_median_80", garg),
        ("garg_lower_median_80", DepthProtocol { scaling: DepthScaling::LowerMedian, ..garg }),
        ("garg_median_80_no_clamp", DepthProtocol { clamp: false, ..garg }),
        ("median_200", DepthProtocol { max_depth: 200.0, ..DepthProtocol::default() }),
    ]
}

fn assert_matches(got: &DepthImage, want: &Value, clamped: bool, label: &str) {
    let count = |name: &str| want[name].as_u64().unwrap() as usize;
    assert_eq!(got.valid_pixels, count("n_valid"), "{label}");
    if clamped {
        assert_eq!((got.below_min, got.above_max), (count("n_below_min"), count("n_above_max")), "{label}");
    }
    let pairs = DepthScores::NAMES.into_iter().zip(got.scores.values());
    for (name, value) in pairs.chain([("ratio", got.scale)]) {
        let expected = want[name].as_f64().unwrap();
        let error = (value - expected).abs() / expected.abs().max(1e-12);
        assert!(error < 2e-5, "{label} {name}: {value} against {expected}");
    }
}

#[test]
fn depth_metrics_match() {
    let (golden, numbers) = open();
    for scene in ["small_0", "small_3", "small_4"] {
        let truth = sparse_truth(&golden, scene);
        let depth = map(PREDICTION, disparity(&golden, scene).map(|d| 1.0 / d));
        let depth = resize_depth(&depth, truth.height, truth.width).unwrap();
        for (name, protocol) in protocols() {
            let got = evaluate_depth_image(&protocol, &depth, &truth, None).unwrap().unwrap();
            assert_matches(&got, &numbers[name][scene], protocol.clamp, &format!("{name} {scene}"));
        }
    }
}

#[test]
fn a_scene_without_pixels_in_the_crop_has_no_metrics() {
    let empty = sparse_truth(&open().0, "empty");
    let ones = map(TRUTH, empty.data.iter().map(|_| 1.0));
    assert!(evaluate_depth_image(&DepthProtocol::kitti_eigen(), &ones, &empty, None).unwrap().is_none());
}

#[test]
fn resized_values_match() {
    let (golden, numbers) = open();
    let disparity = map(PREDICTION, disparity(&golden, "small_0"));
    for case in ["small_0", "small_0_down"] {
        let want = &numbers["resize"][case];
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
