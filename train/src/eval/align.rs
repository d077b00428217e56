//! Bringing a predicted trajectory onto the true one: common first frame, then one of five alignments.

use std::collections::BTreeMap;

use dimode_geometry::{Se3, StampedPose, Trajectory, umeyama};
use nalgebra::{Matrix3, Matrix4, Vector3};
use serde::{Deserialize, Serialize};

use super::EvalError;

/// What is fitted between predicted and true positions before they are compared.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Alignment {
    /// Nothing.
    None,
    /// One factor, least squares through the common first position.
    Scale,
    /// Rotation and translation (6 degrees of freedom).
    Se3,
    /// Rotation, translation and scale (7 degrees of freedom): the usual choice for monocular trajectories.
    #[default]
    Sim3,
    /// The scale of the 7-degree fit alone.
    Scale7dof,
}

impl Alignment {
    /// Name for titles and legends.
    pub fn label(self) -> &'static str {
        match self {
            Self::None => "no alignment",
            Self::Scale => "scale only",
            Self::Se3 => "SE(3), 6 DoF",
            Self::Sim3 => "Sim(3), 7 DoF",
            Self::Scale7dof => "scale of the 7-DoF fit",
        }
    }
}

/// Which of two formulas is used for inverses and angles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Arithmetic {
    /// General 4x4 inverse and arccos of the clamped trace on the matrices as they are: reproduces kitti-odom-eval, also
    /// its sensitivity to poses stored with seven digits.
    #[default]
    Compat,
    /// Rotations made orthonormal on reading, transposed inverse, angle by atan2: exact for tiny angles.
    Robust,
}

impl Arithmetic {
    /// Inverse of a pose that was accepted on reading.
    pub(crate) fn inverse(self, pose: &Matrix4<f64>) -> Matrix4<f64> {
        match self {
            Self::Compat => pose.try_inverse().expect("poses are checked for inversion on reading"),
            Self::Robust => matrix(&se3(pose).inverse()),
        }
    }

    /// Rotation angle in radians, 0 to pi.
    pub(crate) fn angle(self, pose: &Matrix4<f64>) -> f64 {
        let r: Matrix3<f64> = pose.fixed_view::<3, 3>(0, 0).into_owned();
        let cosine = 0.5 * (r.trace() - 1.0);
        match self {
            Self::Compat => cosine.clamp(-1.0, 1.0).acos(),
            Self::Robust => robust_angle(&r),
        }
    }

    /// `inverse(from) * to`.
    pub(crate) fn relative(self, from: &Matrix4<f64>, to: &Matrix4<f64>) -> Matrix4<f64> {
        self.inverse(from) * to
    }
}

/// Angle of a rotation in radians by atan2 of the skew part against the trace, 0 to pi.
pub(crate) fn robust_angle(r: &Matrix3<f64>) -> f64 {
    let skew = Vector3::new(r.m32 - r.m23, r.m13 - r.m31, r.m21 - r.m12);
    (0.5 * skew.norm()).atan2(0.5 * (r.trace() - 1.0))
}

fn matrix(pose: &Se3) -> Matrix4<f64> {
    let mut m = Matrix4::identity();
    m.fixed_view_mut::<3, 3>(0, 0).copy_from(&pose.rotation);
    m.fixed_view_mut::<3, 1>(0, 3).copy_from(&pose.translation);
    m
}

fn se3(m: &Matrix4<f64>) -> Se3 {
    Se3 { rotation: m.fixed_view::<3, 3>(0, 0).into_owned(), translation: position(m) }
}

pub(crate) fn position(m: &Matrix4<f64>) -> Vector3<f64> {
    m.fixed_view::<3, 1>(0, 3).into_owned()
}

/// Poses by frame index.
pub(crate) type Poses = BTreeMap<usize, Matrix4<f64>>;

/// Both trajectories in one frame.
pub(crate) struct Aligned {
    /// All true frames.
    pub truth: Poses,
    /// Predicted frames that the truth knows, aligned.
    pub prediction: Poses,
    /// Predicted frames without truth, left out.
    pub unmatched: usize,
    /// Factor put on predicted positions.
    pub scale: f64,
    /// Whether the fitted rotation is arbitrary about the line of travel.
    pub rotation_ambiguous: bool,
}

/// Both trajectories in the frame of the first common pose, the predicted one aligned to the true one.
#[derive(Clone, Debug)]
pub struct AlignedTrajectory {
    /// Ground truth, `world_from_camera`, first common pose at the origin.
    pub truth: Trajectory,
    /// Aligned prediction.
    pub prediction: Trajectory,
    /// Factor put on the predicted positions.
    pub scale: f64,
    /// Whether the fitted rotation is arbitrary about the line of travel (positions on one line).
    pub rotation_ambiguous: bool,
}

/// Aligns a predicted trajectory to the true one, for plots and files. Both hold `world_from_camera`; frames are matched by
/// index.
///
/// **Errors** for poses that are not finite, no common frame, and positions that do not determine the alignment.
pub fn align_trajectory(
    prediction: &Trajectory,
    truth: &Trajectory,
    alignment: Alignment,
) -> Result<AlignedTrajectory, EvalError> {
    let aligned = align_poses(prediction, truth, alignment, Arithmetic::Robust)?;
    Ok(AlignedTrajectory {
        truth: trajectory(&aligned.truth),
        prediction: trajectory(&aligned.prediction),
        scale: aligned.scale,
        rotation_ambiguous: aligned.rotation_ambiguous,
    })
}

fn trajectory(poses: &Poses) -> Trajectory {
    let poses = poses.iter().map(|(&index, pose)| StampedPose { index, stamp: None, world_from_camera: se3(pose) });
    Trajectory { poses: poses.collect() }
}

/// Re-anchors every pose of both sides at the first common frame, then aligns.
pub(crate) fn align_poses(
    prediction: &Trajectory,
    truth: &Trajectory,
    alignment: Alignment,
    arithmetic: Arithmetic,
) -> Result<Aligned, EvalError> {
    let truth = read("true trajectory", truth, arithmetic)?;
    let all = read("predicted trajectory", prediction, arithmetic)?;
    let total = all.len();
    let span = |poses: &Poses| match (poses.first_key_value(), poses.last_key_value()) {
        (Some((a, _)), Some((b, _))) => format!("{a} to {b}"),
        _ => "none".to_owned(),
    };
    let names = (span(&all), span(&truth));
    let common: Poses = all.into_iter().filter(|(index, _)| truth.contains_key(index)).collect();
    let Some((&first, p0)) = common.first_key_value() else {
        return Err(EvalError::NoCommonFrame { predicted: names.0, truth: names.1 });
    };
    if common.len() < 2 {
        return Err(EvalError::TooFew { what: "common frames of predicted and true trajectory", needed: 2, found: common.len() });
    }
    let (from_p, from_g) = (arithmetic.inverse(p0), arithmetic.inverse(&truth[&first]));
    let anchored = |poses: &Poses, from: &Matrix4<f64>| -> Poses { poses.iter().map(|(i, pose)| (*i, from * pose)).collect() };
    let mut aligned = Aligned {
        truth: anchored(&truth, &from_g),
        prediction: anchored(&common, &from_p),
        unmatched: total - common.len(),
        scale: 1.0,
        rotation_ambiguous: false,
    };
    fit(&mut aligned, alignment)?;
    Ok(aligned)
}

/// Reads a trajectory and refuses what cannot be used.
fn read(which: &'static str, t: &Trajectory, arithmetic: Arithmetic) -> Result<Poses, EvalError> {
    let mut poses = Poses::new();
    for pose in &t.poses {
        let index = pose.index;
        let bad = |reason| EvalError::BadPose { which, index, reason };
        let mut m = matrix(&pose.world_from_camera);
        if !m.iter().all(|x| x.is_finite()) {
            return Err(bad("is not finite"));
        }
        if m.determinant() < 1e-6 {
            return Err(bad("is not a rotation and translation"));
        }
        if arithmetic == Arithmetic::Robust {
            m = matrix(&pose.world_from_camera.orthonormalised());
        }
        if poses.insert(index, m).is_some() {
            return Err(bad("occurs twice"));
        }
    }
    Ok(poses)
}

/// Fits and applies the alignment to the prediction.
fn fit(aligned: &mut Aligned, alignment: Alignment) -> Result<(), EvalError> {
    if alignment == Alignment::None {
        return Ok(());
    }
    let x: Vec<_> = aligned.prediction.values().map(position).collect();
    let y: Vec<_> = aligned.prediction.keys().map(|index| position(&aligned.truth[index])).collect();
    let mut motion = Matrix4::identity();
    if alignment == Alignment::Scale {
        aligned.scale = scale_through_origin(&x, &y)?;
    } else {
        let found = similarity(&x, &y, alignment != Alignment::Se3)?;
        aligned.scale = found.scale;
        aligned.rotation_ambiguous = found.rotation_ambiguous;
        if alignment != Alignment::Scale7dof {
            motion = found.motion;
        }
    }
    for pose in aligned.prediction.values_mut() {
        for axis in 0..3 {
            pose[(axis, 3)] *= aligned.scale;
        }
        *pose = motion * *pose;
    }
    Ok(())
}

fn scale_through_origin(x: &[Vector3<f64>], y: &[Vector3<f64>]) -> Result<f64, EvalError> {
    let xy: f64 = x.iter().zip(y).map(|(x, y)| x.dot(y)).sum();
    let xx: f64 = x.iter().map(Vector3::norm_squared).sum();
    if xx > 0.0 {
        return Ok(xy / xx);
    }
    Err(EvalError::Degenerate { reason: "the predicted positions do not move".to_owned() })
}

struct Similarity {
    motion: Matrix4<f64>,
    scale: f64,
    rotation_ambiguous: bool,
}

fn similarity(x: &[Vector3<f64>], y: &[Vector3<f64>], with_scale: bool) -> Result<Similarity, EvalError> {
    let found = if with_scale { umeyama::similarity(x, y)? } else { umeyama::rigid(x, y)? };
    Ok(Similarity {
        motion: matrix(&Se3 { rotation: found.rotation, translation: found.translation }),
        scale: found.scale,
        rotation_ambiguous: found.rotation_ambiguous,
    })
}
