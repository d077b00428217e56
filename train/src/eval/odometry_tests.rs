//! Known answers, invariances, and agreement with a second program and with kitti-odom-eval.

use std::path::{Path, PathBuf};

use dimode_geometry::{Se3, StampedPose, Trajectory};
use nalgebra::Vector3;
use serde_json::Value;

use super::*;

const ALIGNMENTS: [(&str, &str, Alignment); 5] = [
    ("none", "none", Alignment::None),
    ("scale", "scale", Alignment::Scale),
    ("se3", "6dof", Alignment::Se3),
    ("sim3", "7dof", Alignment::Sim3),
    ("scale_7dof", "scale_7dof", Alignment::Scale7dof),
];

fn poses(list: impl IntoIterator<Item = Se3>) -> Trajectory {
    Trajectory::from_poses(list)
}

/// A camera on a spiral staircase of some size, one pose a step.
fn spiral(count: usize, size: f64) -> Trajectory {
    poses((0..count).map(|i| {
        let a = 0.1 * i as f64;
        let position = Vector3::new(a.cos(), 0.02 * i as f64, a.sin()) * size;
        Se3::from_rotation_vector(&Vector3::new(0.0, -a, 0.0), position)
    }))
}

fn moved(t: &Trajectory, motion: &Se3, scale: f64) -> Trajectory {
    poses(t.poses.iter().map(|pose| {
        let mut p = pose.world_from_camera;
        p.translation *= scale;
        motion.compose(&p)
    }))
}

fn robust(alignment: Alignment) -> OdometryProtocol {
    OdometryProtocol { alignment, ..OdometryProtocol::small_world() }
}

#[test]
fn a_similar_trajectory_has_no_error_after_alignment() {
    let truth = spiral(80, 12.0);
    let motion = Se3::from_rotation_vector(&Vector3::new(0.3, -1.0, 0.2), Vector3::new(5.0, 6.0, 7.0));
    let got = evaluate_odometry(&moved(&truth, &motion, 0.05), &truth, &robust(Alignment::Sim3)).unwrap();
    assert!(got.ate_m < 1e-9, "{}", got.ate_m);
    assert!(got.e_t_percent.unwrap() < 1e-9 && got.e_r_deg_per_100m.unwrap() < 1e-9);
    assert!((got.scale - 20.0).abs() < 1e-9);
    assert_eq!((got.frames, got.rpe_pairs, got.rotation_ambiguous), (80, 79, false));
}

#[test]
fn straight_line_with_wrong_speed() {
    let line = |step: f64| {
        poses((0..31).map(|i| Se3::from_rotation_vector(&Vector3::zeros(), Vector3::new(0.0, 0.0, step * f64::from(i)))))
    };
    let protocol =
        OdometryProtocol { alignment: Alignment::None, lengths: vec![9.5], start_step: 10, arithmetic: Arithmetic::Compat };
    let got = evaluate_odometry(&line(1.1), &line(1.0), &protocol).unwrap();
    // From frames 0, 10, 20 the first frame beyond 9.5 m is 10 frames on: 11 m against 10 m, over 9.5 m.
    assert_eq!(got.segments, 3);
    assert!((got.e_t_percent.unwrap() - 100.0 / 9.5).abs() < 1e-9);
    assert!((got.rpe_translation_m.unwrap() - 0.1).abs() < 1e-12);
    let squares: f64 = (0..31).map(|i| (0.1 * f64::from(i)).powi(2)).sum();
    assert!((got.ate_m - (squares / 31.0).sqrt()).abs() < 1e-12);
    let scaled = evaluate_odometry(&line(1.1), &line(1.0), &robust(Alignment::Sim3)).unwrap();
    assert!(scaled.ate_m < 1e-9 && scaled.rotation_ambiguous);
}

#[test]
fn a_short_path_has_no_sub_sequences() {
    let truth = spiral(20, 3.0);
    let got = evaluate_odometry(&truth, &truth, &OdometryProtocol::default()).unwrap();
    assert_eq!((got.e_t_percent, got.e_r_deg_per_100m, got.segments), (None, None, 0));
    assert!(got.ate_m < 1e-12);
}

#[test]
fn errors_are_clear() {
    let truth = spiral(20, 3.0);
    let protocol = OdometryProtocol::small_world();
    let say = |p: &Trajectory| evaluate_odometry(p, &truth, &protocol).unwrap_err().to_string();
    assert!(say(&poses(vec![Se3::identity(); 20])).contains("no extent"));
    let mut later = truth.clone();
    later.poses.iter_mut().for_each(|pose| pose.index += 100);
    assert!(say(&later).contains("100 to 119") && say(&later).contains("0 to 19"));
    let mut bad = truth.clone();
    bad.poses[7].world_from_camera.translation.x = f64::NAN;
    assert!(say(&bad).contains("predicted trajectory: pose of frame 7 is not finite"));
    let mut twice = truth.clone();
    twice.poses[3].index = 2;
    assert!(say(&twice).contains("frame 2 occurs twice"));
    assert!(say(&Trajectory { poses: truth.poses[..1].to_vec() }).contains("at least 2 needed"));
    let wrong = OdometryProtocol { lengths: vec![-5.0], ..protocol.clone() };
    assert!(evaluate_odometry(&truth, &truth, &wrong).is_err());
    let still = poses(vec![Se3::identity(); 20]);
    let scale = robust(Alignment::Scale);
    assert!(evaluate_odometry(&still, &truth, &scale).unwrap_err().to_string().contains("do not move"));
}

#[test]
fn robust_and_compat_agree_on_exact_poses() {
    let truth = spiral(120, 30.0);
    let motion = Se3::from_rotation_vector(&Vector3::new(0.0, 0.001, 0.0), Vector3::zeros());
    let bent =
        Trajectory::accumulate(&crate::eval::motion::steps_of(&truth).iter().map(|s| s.compose(&motion)).collect::<Vec<_>>());
    let robust = evaluate_odometry(&bent, &truth, &robust(Alignment::Sim3)).unwrap();
    let compat = OdometryProtocol { arithmetic: Arithmetic::Compat, ..OdometryProtocol::small_world() };
    let compat = evaluate_odometry(&bent, &truth, &compat).unwrap();
    assert_eq!(robust.segments, compat.segments);
    assert!((robust.ate_m / compat.ate_m - 1.0).abs() < 1e-9);
    assert!((robust.rpe_rotation_deg.unwrap() - 0.001f64.to_degrees()).abs() < 1e-9);
    assert!((robust.e_r_deg_per_100m.unwrap() / compat.e_r_deg_per_100m.unwrap() - 1.0).abs() < 1e-6);
}

/// Reads KITTI text, with or without a frame index in front.
fn read(path: &Path) -> Trajectory {
    Trajectory::read_kitti(path).expect("golden trajectory")
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).expect("golden file")).expect("JSON")
}

fn close(got: f64, want: &Value, tolerance: f64, label: &str) {
    let want = want.as_f64().expect("a number");
    assert!((got / want - 1.0).abs() < tolerance, "{label}: {got} against {want}");
}

#[test]
fn odometry_agrees_with_the_second_program() {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/golden/evaluation"));
    let truth = read(&folder.join("odometry_truth.txt"));
    let estimate = read(&folder.join("odometry_estimate.txt"));
    let numbers = json(&folder.join("odometry.json"));
    for (name, _, alignment) in ALIGNMENTS {
        let protocol = OdometryProtocol { alignment, ..OdometryProtocol::default() };
        let got = evaluate_odometry(&estimate, &truth, &protocol).unwrap();
        let want = &numbers[name];
        close(got.e_t_percent.unwrap(), &want["e_t_percent"], 1e-9, name);
        close(got.e_r_deg_per_100m.unwrap(), &want["e_r_deg_per_100m"], 1e-9, name);
        close(got.ate_m, &want["ate_m"], 1e-9, name);
        close(got.rpe_translation_m.unwrap(), &want["rpe_translation_m"], 1e-9, name);
        close(got.rpe_rotation_deg.unwrap(), &want["rpe_rotation_deg"], 1e-9, name);
        close(got.scale, &want["scale"], 1e-9, name);
        assert_eq!(got.segments as u64, want["segments"].as_u64().unwrap());
        assert_eq!(got.rpe_pairs as u64, want["rpe_pairs"].as_u64().unwrap());
        let rows = want["per_length"].as_array().unwrap();
        assert_eq!(rows.len(), got.per_length.len());
        for (row, got) in rows.iter().zip(&got.per_length) {
            assert_eq!((row[0].as_f64(), row[1].as_u64()), (Some(got.length_m), Some(got.segments as u64)));
            close(got.e_t_percent, &row[2], 1e-9, name);
            close(got.e_r_deg_per_100m, &row[3], 1e-9, name);
        }
    }
}

/// The folder of kitti-odom-eval's numbers and files, which may not be part of this repository.
fn kitti_folder() -> Option<PathBuf> {
    let folder = std::env::var_os("DIMODE_GOLDEN_EVALUATION").map(PathBuf::from);
    if folder.is_none() {
        eprintln!("skipped: DIMODE_GOLDEN_EVALUATION names no folder");
    }
    folder
}

#[test]
fn kitti_tool_parity() {
    let Some(folder) = kitti_folder() else { return };
    let numbers = json(&folder.join("metrics.json"));
    for (example, sequence) in [("example_0", "09"), ("example_0", "10"), ("example_1", "09"), ("example_1", "10")] {
        let truth = read(&folder.join(format!("odometry/gt_poses/{sequence}.txt")));
        let estimate = read(&folder.join(format!("odometry/{example}/{sequence}.txt")));
        for (_, name, alignment) in ALIGNMENTS {
            let protocol = OdometryProtocol { alignment, ..OdometryProtocol::default() };
            let got = evaluate_odometry(&estimate, &truth, &protocol).unwrap();
            let want = &numbers["kitti_odom_eval"]["values"][example][name][sequence];
            let label = format!("{example} {sequence} {name}");
            close(got.e_t_percent.unwrap(), &want["e_t_percent"], 1e-9, &label);
            close(got.e_r_deg_per_100m.unwrap(), &want["e_r_deg_per_100m"], 1e-9, &label);
            close(got.ate_m, &want["ate_rmse_m"], 1e-9, &label);
            close(got.rpe_translation_m.unwrap(), &want["rpe_trans_mean_m"], 1e-9, &label);
            close(got.rpe_rotation_deg.unwrap(), &want["rpe_rot_mean_deg"], 1e-9, &label);
            assert_eq!(got.segments as u64, want["n_segments"].as_u64().unwrap(), "{label}");
        }
    }
}

#[test]
fn kitti_tool_gap_case() {
    let Some(folder) = kitti_folder() else { return };
    let numbers = json(&folder.join("metrics.json"));
    let truth = read(&folder.join("odometry/gt_poses/09.txt"));
    let mut estimate = read(&folder.join("odometry/example_0/09.txt"));
    estimate.poses.retain(|pose: &StampedPose| !(500..520).contains(&pose.index));
    let got = evaluate_odometry(&estimate, &truth, &OdometryProtocol::default()).unwrap();
    let want = &numbers["kitti_odom_eval"]["gap_case"]["correct"];
    close(got.e_t_percent.unwrap(), &want["e_t_percent"], 1e-9, "e_t");
    close(got.e_r_deg_per_100m.unwrap(), &want["e_r_deg_per_100m"], 1e-9, "e_r");
    close(got.ate_m, &want["ate_rmse_m"], 1e-9, "ATE");
    assert_eq!(got.segments, 925);
}
