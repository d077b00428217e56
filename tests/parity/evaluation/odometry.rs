//! Odometry metrics, against a program in NumPy and against kitti-odom-eval.

use dimode::eval::{Alignment, OdometryProtocol, evaluate_odometry};
use dimode_geometry::{StampedPose, Trajectory};
use dimode_tests::{available, json, path};
use serde_json::Value;

/// Each alignment by its names in the program in NumPy and in kitti-odom-eval.
const ALIGNMENTS: [(&str, &str, Alignment); 5] = [
    ("none", "none", Alignment::None),
    ("scale", "scale", Alignment::Scale),
    ("se3", "6dof", Alignment::Se3),
    ("sim3", "7dof", Alignment::Sim3),
    ("scale_7dof", "scale_7dof", Alignment::Scale7dof),
];

/// kitti-odom-eval's numbers, which may not be part of this repository.
const KITTI: &str = "evaluation/metrics.json";

/// Reads KITTI text, with or without a frame index in front.
fn read(file: &str) -> Trajectory {
    Trajectory::read_kitti(&path(&format!("evaluation/{file}"))).expect("a trajectory in KITTI form")
}

#[track_caller]
fn close(got: f64, want: &Value, label: &str) {
    let want = want.as_f64().expect("a number");
    assert!((got / want - 1.0).abs() < 1e-9, "{label}: {got} against {want}");
}

#[test]
fn odometry_matches_the_program_in_numpy() {
    let (truth, estimate) = (read("odometry_truth.txt"), read("odometry_estimate.txt"));
    let numbers = json("evaluation/odometry.json");
    for (name, _, alignment) in ALIGNMENTS {
        let protocol = OdometryProtocol { alignment, ..OdometryProtocol::default() };
        let got = evaluate_odometry(&estimate, &truth, &protocol).unwrap();
        let want = &numbers[name];
        close(got.e_t_percent.unwrap(), &want["e_t_percent"], name);
        close(got.e_r_deg_per_100m.unwrap(), &want["e_r_deg_per_100m"], name);
        close(got.ate_m, &want["ate_m"], name);
        close(got.rpe_translation_m.unwrap(), &want["rpe_translation_m"], name);
        close(got.rpe_rotation_deg.unwrap(), &want["rpe_rotation_deg"], name);
        close(got.scale, &want["scale"], name);
        assert_eq!(got.segments as u64, want["segments"].as_u64().unwrap());
        assert_eq!(got.rpe_pairs as u64, want["rpe_pairs"].as_u64().unwrap());
        let rows = want["per_length"].as_array().unwrap();
        assert_eq!(rows.len(), got.per_length.len());
        for (row, got) in rows.iter().zip(&got.per_length) {
            assert_eq!((row[0].as_f64(), row[1].as_u64()), (Some(got.length_m), Some(got.segments as u64)));
            close(got.e_t_percent, &row[2], name);
            close(got.e_r_deg_per_100m, &row[3], name);
        }
    }
}

#[test]
fn odometry_matches_kitti_odom_eval() {
    if !available(KITTI) {
        return;
    }
    let numbers = json(KITTI);
    for (example, sequence) in [("example_0", "09"), ("example_0", "10"), ("example_1", "09"), ("example_1", "10")] {
        let truth = read(&format!("odometry/gt_poses/{sequence}.txt"));
        let estimate = read(&format!("odometry/{example}/{sequence}.txt"));
        for (_, name, alignment) in ALIGNMENTS {
            let protocol = OdometryProtocol { alignment, ..OdometryProtocol::default() };
            let got = evaluate_odometry(&estimate, &truth, &protocol).unwrap();
            let want = &numbers["kitti_odom_eval"]["values"][example][name][sequence];
            let label = format!("{example} {sequence} {name}");
            close(got.e_t_percent.unwrap(), &want["e_t_percent"], &label);
            close(got.e_r_deg_per_100m.unwrap(), &want["e_r_deg_per_100m"], &label);
            close(got.ate_m, &want["ate_rmse_m"], &label);
            close(got.rpe_translation_m.unwrap(), &want["rpe_trans_mean_m"], &label);
            close(got.rpe_rotation_deg.unwrap(), &want["rpe_rot_mean_deg"], &label);
            assert_eq!(got.segments as u64, want["n_segments"].as_u64().unwrap(), "{label}");
        }
    }
}

#[test]
fn odometry_with_a_gap_matches_kitti_odom_eval() {
    if !available(KITTI) {
        return;
    }
    let numbers = json(KITTI);
    let truth = read("odometry/gt_poses/09.txt");
    let mut estimate = read("odometry/example_0/09.txt");
    estimate.poses.retain(|pose: &StampedPose| !(500..520).contains(&pose.index));
    let got = evaluate_odometry(&estimate, &truth, &OdometryProtocol::default()).unwrap();
    let want = &numbers["kitti_odom_eval"]["gap_case"]["correct"];
    close(got.e_t_percent.unwrap(), &want["e_t_percent"], "e_t");
    close(got.e_r_deg_per_100m.unwrap(), &want["e_r_deg_per_100m"], "e_r");
    close(got.ate_m, &want["ate_rmse_m"], "ATE");
    assert_eq!(got.segments, 925);
}
