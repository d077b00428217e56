//! Known answers and invariances.

use dimode_geometry::{Se3, Trajectory};
use nalgebra::Vector3;

use super::*;

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
