//! Known answers and limits.

use super::*;
use crate::eval::depth_protocol::Crop;

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
