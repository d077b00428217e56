//! Scoring one trajectory file against another.

use std::path::{Path, PathBuf};

use anyhow::Result;
use dimode_geometry::Trajectory;
use serde::Serialize;

use crate::data::DataError;
use crate::eval::{Alignment, Arithmetic, EvalError, OdometryErrors, OdometryProtocol, evaluate_odometry};

/// How a trajectory is written in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum TrajectoryFormat {
    /// 12 numbers a line, or 13 with the frame index first.
    Kitti,
    /// Time, position, quaternion: 8 numbers a line.
    Tum,
}

/// Choices behind the numbers that were asked for.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct OdometryChanges {
    /// Fit before the comparison.
    pub alignment: Option<Alignment>,
    /// Lengths of the sub-sequences in metres; empty for those of the protocol.
    pub lengths: Vec<f64>,
    /// Frames between the starts of sub-sequences.
    pub start_step: Option<usize>,
    /// How angles and inverses are computed.
    pub arithmetic: Option<Arithmetic>,
}

impl OdometryChanges {
    /// The protocol with these choices.
    pub fn on(&self, base: OdometryProtocol) -> OdometryProtocol {
        OdometryProtocol {
            alignment: self.alignment.unwrap_or(base.alignment),
            lengths: if self.lengths.is_empty() { base.lengths } else { self.lengths.clone() },
            start_step: self.start_step.unwrap_or(base.start_step),
            arithmetic: self.arithmetic.unwrap_or(base.arithmetic),
        }
    }
}

/// What to compare and how.
#[derive(Clone, Debug)]
pub struct EvalOdometryRequest {
    /// True trajectory.
    pub truth: PathBuf,
    /// Estimated trajectory.
    pub estimate: PathBuf,
    /// Form of both files; none looks at the number of columns of each.
    pub format: Option<TrajectoryFormat>,
    /// Largest difference of times that still belong together, in seconds; used when both files hold times.
    pub max_time_difference: f64,
    /// Every choice behind the numbers.
    pub protocol: OdometryProtocol,
}

/// The numbers with what they were made of.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EvalOdometryResult {
    /// True trajectory.
    pub truth: PathBuf,
    /// Estimated trajectory.
    pub estimate: PathBuf,
    /// Every choice behind the numbers.
    pub protocol: OdometryProtocol,
    /// The numbers.
    pub errors: OdometryErrors,
}

/// Reads both files and compares them. Frames are matched by their index, or by time when both files hold times.
///
/// **Errors** [`DataError`] and [`dimode_geometry::GeometryError`] for the files, [`EvalError`] for trajectories that cannot be
/// compared and for a time difference that is negative or no number.
pub fn eval_odometry(request: &EvalOdometryRequest) -> Result<EvalOdometryResult> {
    let limit = request.max_time_difference;
    if limit.is_nan() || limit < 0.0 {
        return Err(EvalError::Option { option: "max_time_difference", value: limit, requirement: "must be 0 or more" }.into());
    }
    let truth = read(&request.truth, request.format)?;
    let mut estimate = read(&request.estimate, request.format)?;
    match_times(&truth, &mut estimate, limit);
    let errors = evaluate_odometry(&estimate, &truth, &request.protocol)?;
    Ok(EvalOdometryResult {
        truth: request.truth.clone(),
        estimate: request.estimate.clone(),
        protocol: request.protocol.clone(),
        errors,
    })
}

fn read(path: &Path, format: Option<TrajectoryFormat>) -> Result<Trajectory> {
    let text = std::fs::read_to_string(path).map_err(|error| DataError::read(path, "trajectory file", error))?;
    let format = match format {
        Some(format) => format,
        None => detect(&text, path)?,
    };
    Ok(match format {
        TrajectoryFormat::Kitti => Trajectory::parse_kitti(&text, path)?,
        TrajectoryFormat::Tum => Trajectory::parse_tum(&text, path)?,
    })
}

/// The form by the number of columns of the first line that is no comment.
fn detect(text: &str, path: &Path) -> Result<TrajectoryFormat, DataError> {
    let content = |line: &&str| !line.trim().is_empty() && !line.trim_start().starts_with('#');
    let columns = text.lines().find(content).map_or(0, |line| line.split_whitespace().count());
    match columns {
        8 => Ok(TrajectoryFormat::Tum),
        12 | 13 => Ok(TrajectoryFormat::Kitti),
        _ => {
            let reason = format!("{columns} columns, expected 12 or 13 (KITTI) or 8 (TUM)");
            Err(DataError::malformed(path, reason, "check that this is a trajectory file"))
        }
    }
}

/// Gives every estimated pose the index of the true pose nearest in time, when both hold times. Poses without a partner get
/// indices that the truth does not have, so that they are counted as unmatched; of two with one partner the nearer stays.
fn match_times(truth: &Trajectory, estimate: &mut Trajectory, limit: f64) {
    let known: Vec<(f64, usize)> = truth.poses.iter().filter_map(|pose| Some((pose.stamp?, pose.index))).collect();
    if known.is_empty() || estimate.poses.iter().any(|pose| pose.stamp.is_none()) {
        return;
    }
    let beyond = known.iter().map(|&(_, index)| index + 1).max().unwrap_or(0);
    let mut taken: Vec<Option<(f64, usize)>> = vec![None; beyond];
    for position in 0..estimate.poses.len() {
        let time = estimate.poses[position].stamp.unwrap_or(f64::NAN);
        let nearest = known.iter().map(|&(stamp, index)| ((stamp - time).abs(), index)).min_by(|a, b| a.0.total_cmp(&b.0));
        let unmatched = beyond + position;
        estimate.poses[position].index = unmatched;
        let Some((gap, index)) = nearest.filter(|&(gap, _)| gap <= limit) else { continue };
        match taken[index] {
            Some((before, _)) if before <= gap => continue,
            Some((_, loser)) => estimate.poses[loser].index = beyond + loser,
            None => {}
        }
        taken[index] = Some((gap, position));
        estimate.poses[position].index = index;
    }
    estimate.poses.sort_by_key(|pose| pose.index);
}

impl EvalOdometryResult {
    /// The numbers as lines for a terminal.
    pub fn table(&self) -> String {
        let errors = &self.errors;
        let number = |value: Option<f64>, unit: &str| match value {
            Some(value) => format!("{value:.4}{unit}"),
            None => "not available".to_owned(),
        };
        let mut lines = vec![
            format!("{} against {}", self.estimate.display(), self.truth.display()),
            self.protocol.describe(),
            format!("e_t            {}", number(errors.e_t_percent, " %")),
            format!("e_r            {}", number(errors.e_r_deg_per_100m, " deg / 100 m")),
            format!("ATE            {}", number(Some(errors.ate_m), " m")),
            format!("RPE            {}, {}", number(errors.rpe_translation_m, " m"), number(errors.rpe_rotation_deg, " deg")),
            format!("scale          {}", number(Some(errors.scale), "")),
            format!("frames         {} compared, {} without truth", errors.frames, errors.unmatched_frames),
            format!("path           {:.2} m, {} sub-sequences", errors.path_length_m, errors.segments),
        ];
        if errors.rotation_ambiguous {
            lines.push("positions lie on one line: the fitted rotation about it is arbitrary".to_owned());
        }
        lines.join("\n")
    }
}

#[cfg(test)]
mod tests {
    use dimode_geometry::Se3;
    use nalgebra::Vector3;

    use super::*;
    use crate::eval::Alignment;

    fn path_of(scale: f64) -> Trajectory {
        let pose = |i: usize| {
            let t = i as f64;
            let turn = Vector3::new(0.0, 0.05 * t, 0.0);
            Se3::from_rotation_vector(&turn, scale * Vector3::new((0.3 * t).sin(), 0.1 * (0.7 * t).cos(), t))
        };
        Trajectory::from_poses((0..20).map(pose))
    }

    fn request(folder: &Path, alignment: Alignment) -> EvalOdometryRequest {
        EvalOdometryRequest {
            truth: folder.join("truth.txt"),
            estimate: folder.join("estimate.txt"),
            format: None,
            max_time_difference: 0.02,
            protocol: OdometryProtocol { alignment, ..OdometryProtocol::small_world() },
        }
    }

    #[test]
    fn a_scaled_copy_has_no_error_after_alignment_and_a_known_scale() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("truth.txt"), path_of(1.0).to_kitti(false)).unwrap();
        std::fs::write(folder.path().join("estimate.txt"), path_of(0.25).to_kitti(false)).unwrap();
        let aligned = eval_odometry(&request(folder.path(), Alignment::Sim3)).unwrap();
        assert!(aligned.errors.ate_m < 1e-4, "{}", aligned.errors.ate_m);
        assert!((aligned.errors.scale - 4.0).abs() < 1e-4);
        let raw = eval_odometry(&request(folder.path(), Alignment::None)).unwrap();
        assert!(raw.errors.ate_m > 1.0);
        assert!(raw.table().contains("no alignment"));
    }

    #[test]
    fn what_is_not_available_has_no_unit() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["truth.txt", "estimate.txt"] {
            std::fs::write(folder.path().join(name), path_of(0.01).to_kitti(false)).unwrap();
        }
        let table = eval_odometry(&request(folder.path(), Alignment::None)).unwrap().table();
        assert!(table.lines().any(|line| line == "e_t            not available"), "{table}");
        assert!(table.lines().any(|line| line.starts_with("ATE") && line.ends_with(" m")), "{table}");
    }

    #[test]
    fn a_negative_difference_of_times_is_refused() {
        for bad in [-1.0, f64::NAN] {
            let request = EvalOdometryRequest { max_time_difference: bad, ..request(Path::new("none"), Alignment::Sim3) };
            let message = eval_odometry(&request).unwrap_err().to_string();
            assert_eq!(message, format!("max_time_difference = {bad}: must be 0 or more"));
        }
    }

    #[test]
    fn times_are_matched_when_both_files_hold_them() {
        let folder = tempfile::tempdir().unwrap();
        let mut truth = path_of(1.0);
        for pose in &mut truth.poses {
            pose.stamp = Some(0.1 * pose.index as f64);
        }
        let mut estimate = Trajectory { poses: truth.poses[3..].to_vec() };
        for pose in &mut estimate.poses {
            pose.stamp = pose.stamp.map(|stamp| stamp + 0.004);
        }
        estimate.poses[5].stamp = Some(0.85);
        std::fs::write(folder.path().join("truth.txt"), truth.to_tum()).unwrap();
        std::fs::write(folder.path().join("estimate.txt"), estimate.to_tum()).unwrap();
        let result = eval_odometry(&request(folder.path(), Alignment::Sim3)).unwrap();
        assert_eq!((result.errors.frames, result.errors.unmatched_frames), (16, 1));
        assert!(result.errors.ate_m < 1e-4, "{}", result.errors.ate_m);
    }

    #[test]
    fn files_that_are_no_trajectories_are_named() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("truth.txt"), "1 2 3\n").unwrap();
        let message = eval_odometry(&request(folder.path(), Alignment::Sim3)).unwrap_err().to_string();
        assert!(message.contains("truth.txt: 3 columns, expected 12 or 13"), "{message}");
        std::fs::remove_file(folder.path().join("truth.txt")).unwrap();
        let message = eval_odometry(&request(folder.path(), Alignment::Sim3)).unwrap_err().to_string();
        assert!(message.contains("truth.txt: trajectory file not found"), "{message}");
    }
}
