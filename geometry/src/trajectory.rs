//! Camera trajectories and their text files.
//!
//! A pose is `world_from_camera` (KITTI: x right, y down, z forward). Two file forms are read and
//! written: KITTI (12 numbers a line, or 13 with the frame index first) and TUM
//! (`stamp tx ty tz qx qy qz qw`).

use std::path::Path;

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

use crate::error::GeometryError;
use crate::se3::Se3;

/// Largest entry of `R^T R - I` accepted from a text file.
pub const ROTATION_TOLERANCE: f64 = 1e-4;
/// Largest distance of a quaternion's length from 1 accepted from a text file.
pub const QUATERNION_TOLERANCE: f64 = 1e-2;

/// One pose of a trajectory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StampedPose {
    /// Frame index within the sequence.
    pub index: usize,
    /// Time in seconds, where the file has one.
    pub stamp: Option<f64>,
    /// Carries camera-frame points to the world.
    pub world_from_camera: Se3,
}

/// Poses in rising order of their frame index.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trajectory {
    /// The poses.
    pub poses: Vec<StampedPose>,
}

impl Trajectory {
    /// Poses with indices 0, 1, 2 and so on.
    #[must_use]
    pub fn from_poses(world_from_camera: impl IntoIterator<Item = Se3>) -> Self {
        let poses = world_from_camera
            .into_iter()
            .enumerate()
            .map(|(index, world_from_camera)| StampedPose {
                index,
                stamp: None,
                world_from_camera,
            })
            .collect();
        Self { poses }
    }

    /// Chains motions between neighbouring frames.
    ///
    /// `steps[i]` is the `source_from_target` of target frame `i` and source frame `i + 1`;
    /// `W_0 = I`, `W_{i+1} = W_i T_i^-1`. The result has one pose more than there are steps.
    #[must_use]
    pub fn accumulate(steps: &[Se3]) -> Self {
        let mut world_from_camera = Se3::identity();
        let mut poses = vec![world_from_camera];
        for source_from_target in steps {
            world_from_camera = world_from_camera * source_from_target.inverse();
            poses.push(world_from_camera);
        }
        Self::from_poses(poses)
    }

    /// Number of poses.
    #[must_use]
    pub fn len(&self) -> usize {
        self.poses.len()
    }

    /// Whether there is no pose.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.poses.is_empty()
    }

    /// Camera centres in the world, in order.
    #[must_use]
    pub fn positions(&self) -> Vec<Vector3<f64>> {
        self.poses
            .iter()
            .map(|p| p.world_from_camera.translation)
            .collect()
    }

    /// The pose of frame `index`.
    #[must_use]
    pub fn pose(&self, index: usize) -> Option<&Se3> {
        let at = self.poses.binary_search_by_key(&index, |p| p.index).ok()?;
        Some(&self.poses[at].world_from_camera)
    }

    /// Motion from frame `target` to frame `source` (`source_from_target`), if both exist.
    #[must_use]
    pub fn source_from_target(&self, target: usize, source: usize) -> Option<Se3> {
        Some(self.pose(source)?.inverse() * *self.pose(target)?)
    }

    /// The same trajectory seen from its first camera, so that the first pose is the identity.
    #[must_use]
    pub fn anchored_at_first(&self) -> Self {
        let Some(first) = self.poses.first() else {
            return Self::default();
        };
        let camera_from_world = first.world_from_camera.inverse();
        let poses = self
            .poses
            .iter()
            .map(|p| StampedPose {
                world_from_camera: camera_from_world * p.world_from_camera,
                ..*p
            })
            .collect();
        Self { poses }
    }

    /// Length of the polyline through the camera centres, in the units of the translations.
    #[must_use]
    pub fn path_length(&self) -> f64 {
        self.positions()
            .windows(2)
            .map(|w| (w[1] - w[0]).norm())
            .sum()
    }

    /// Reads a KITTI pose file; matrices are kept exactly as written.
    ///
    /// # Errors
    /// [`GeometryError::Io`], or [`GeometryError::Parse`] naming file and line.
    pub fn read_kitti(path: &Path) -> Result<Self, GeometryError> {
        Self::parse_kitti(&read(path)?, path)
    }

    /// As [`Trajectory::read_kitti`], on text; `path` only names the origin in errors.
    ///
    /// # Errors
    /// [`GeometryError::Parse`] for a wrong count of numbers, a value that is no finite number, a
    /// 3x3 part that is no rotation, or an index that is repeated or not a whole number.
    pub fn parse_kitti(text: &str, path: &Path) -> Result<Self, GeometryError> {
        let mut poses: Vec<StampedPose> = Vec::new();
        let mut lines = Vec::new();
        let mut columns = None;
        for (line, content) in content_lines(text) {
            let fail = |reason| parse_error(path, line, reason);
            let numbers = numbers(content).map_err(fail)?;
            let expected = *columns.get_or_insert(numbers.len());
            if !(matches!(expected, 12 | 13) && numbers.len() == expected) {
                return Err(fail(wrong_count(numbers.len(), expected)));
            }
            let (index, row) = match numbers.len() {
                13 => (frame_index(numbers[0]).map_err(fail)?, &numbers[1..]),
                _ => (poses.len(), &numbers[..]),
            };
            let world_from_camera = kitti_pose(row)
                .checked("KITTI pose row", ROTATION_TOLERANCE)
                .map_err(|e| fail(e.to_string()))?;
            lines.push(line);
            poses.push(StampedPose {
                index,
                stamp: None,
                world_from_camera,
            });
        }
        ordered(poses, &lines, path)
    }

    /// KITTI text, 12 numbers a line, or 13 with the frame index first.
    #[must_use]
    pub fn to_kitti(&self, with_index: bool) -> String {
        let mut text = String::new();
        for pose in &self.poses {
            let m = &pose.world_from_camera;
            let mut fields = Vec::with_capacity(13);
            if with_index {
                fields.push(pose.index.to_string());
            }
            for row in 0..3 {
                fields.extend((0..3).map(|column| scientific(m.rotation[(row, column)])));
                fields.push(scientific(m.translation[row]));
            }
            text.push_str(&fields.join(" "));
            text.push('\n');
        }
        text
    }

    /// Writes [`Trajectory::to_kitti`].
    ///
    /// # Errors
    /// [`GeometryError::Io`].
    pub fn write_kitti(&self, path: &Path, with_index: bool) -> Result<(), GeometryError> {
        write(path, &self.to_kitti(with_index))
    }

    /// Reads a TUM file; quaternions are normalised, indices count the lines with content.
    ///
    /// # Errors
    /// [`GeometryError::Io`], or [`GeometryError::Parse`] naming file and line.
    pub fn read_tum(path: &Path) -> Result<Self, GeometryError> {
        Self::parse_tum(&read(path)?, path)
    }

    /// As [`Trajectory::read_tum`], on text; `path` only names the origin in errors.
    ///
    /// # Errors
    /// [`GeometryError::Parse`] for a wrong count of numbers, a value that is no finite number, a
    /// quaternion that is not of unit length, or stamps that do not rise.
    pub fn parse_tum(text: &str, path: &Path) -> Result<Self, GeometryError> {
        let mut poses: Vec<StampedPose> = Vec::new();
        for (line, content) in content_lines(text) {
            let fail = |reason| parse_error(path, line, reason);
            let numbers = numbers(content).map_err(fail)?;
            let Ok([stamp, x, y, z, qx, qy, qz, qw]) = <[f64; 8]>::try_from(numbers.as_slice())
            else {
                return Err(fail(format!(
                    "{} numbers, expected 8: stamp tx ty tz qx qy qz qw",
                    numbers.len()
                )));
            };
            if poses
                .last()
                .and_then(|p| p.stamp)
                .is_some_and(|last| stamp <= last)
            {
                return Err(fail(format!(
                    "stamp {stamp} does not come after the one before"
                )));
            }
            let q = Quaternion::new(qw, qx, qy, qz);
            if (q.norm() - 1.0).abs() > QUATERNION_TOLERANCE {
                return Err(fail(format!(
                    "quaternion of length {:.6}, expected 1",
                    q.norm()
                )));
            }
            let rotation = UnitQuaternion::new_normalize(q)
                .to_rotation_matrix()
                .into_inner();
            poses.push(StampedPose {
                index: poses.len(),
                stamp: Some(stamp),
                world_from_camera: Se3 {
                    rotation,
                    translation: Vector3::new(x, y, z),
                },
            });
        }
        ordered(poses, &[], path)
    }

    /// TUM text; a pose without a time gets its index as stamp.
    #[must_use]
    pub fn to_tum(&self) -> String {
        let mut text = String::new();
        for pose in &self.poses {
            let m = pose.world_from_camera.orthonormalised();
            let q = UnitQuaternion::from_matrix(&m.rotation);
            let stamp = pose.stamp.unwrap_or(pose.index as f64);
            let t = m.translation;
            let fields: Vec<String> = [t.x, t.y, t.z, q.i, q.j, q.k, q.w]
                .iter()
                .map(|&x| scientific(x))
                .collect();
            text.push_str(&format!("{stamp:.9} {}\n", fields.join(" ")));
        }
        text
    }

    /// Writes [`Trajectory::to_tum`].
    ///
    /// # Errors
    /// [`GeometryError::Io`].
    pub fn write_tum(&self, path: &Path) -> Result<(), GeometryError> {
        write(path, &self.to_tum())
    }
}

fn read(path: &Path) -> Result<String, GeometryError> {
    std::fs::read_to_string(path).map_err(|source| GeometryError::Io {
        path: path.to_owned(),
        source,
    })
}

fn write(path: &Path, text: &str) -> Result<(), GeometryError> {
    std::fs::write(path, text).map_err(|source| GeometryError::Io {
        path: path.to_owned(),
        source,
    })
}

fn parse_error(path: &Path, line: usize, reason: String) -> GeometryError {
    GeometryError::Parse {
        path: path.to_owned(),
        line,
        reason,
    }
}

/// Lines with content and their numbers; blank lines and `#` comments are passed over.
fn content_lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    text.lines()
        .enumerate()
        .map(|(i, line)| (i + 1, line.trim()))
        .filter(|(_, line)| !line.is_empty() && !line.starts_with('#'))
}

fn numbers(line: &str) -> Result<Vec<f64>, String> {
    line.split_whitespace()
        .map(|field| match field.parse::<f64>() {
            Ok(x) if x.is_finite() => Ok(x),
            _ => Err(format!("`{field}` is not a finite number")),
        })
        .collect()
}

fn wrong_count(found: usize, first_line: usize) -> String {
    if matches!(first_line, 12 | 13) {
        return format!("{found} numbers, but the first line has {first_line}");
    }
    format!("{found} numbers, expected 12 (3x4 row by row) or 13 (frame index first)")
}

fn frame_index(value: f64) -> Result<usize, String> {
    if value >= 0.0 && value.fract() == 0.0 && value < 1e15 {
        return Ok(value as usize);
    }
    Err(format!(
        "frame index {value} is not a whole number from 0 up"
    ))
}

fn kitti_pose(row: &[f64]) -> Se3 {
    Se3 {
        rotation: Matrix3::from_fn(|r, c| row[4 * r + c]),
        translation: Vector3::from_fn(|r, _| row[4 * r + 3]),
    }
}

/// Sorts by frame index; `lines[i]` is the line of pose `i`, needed only where an index can repeat.
fn ordered(
    mut poses: Vec<StampedPose>,
    lines: &[usize],
    path: &Path,
) -> Result<Trajectory, GeometryError> {
    if poses.is_empty() {
        return Err(parse_error(path, 1, "no pose in the file".to_owned()));
    }
    let mut order: Vec<usize> = (0..poses.len()).collect();
    order.sort_by_key(|&i| poses[i].index);
    if let Some(w) = order
        .windows(2)
        .find(|w| poses[w[0]].index == poses[w[1]].index)
    {
        let reason = format!("frame index {} appears more than once", poses[w[1]].index);
        let line = lines.get(w[1]).copied().unwrap_or(0);
        return Err(parse_error(path, line, reason));
    }
    poses.sort_by_key(|p| p.index);
    Ok(Trajectory { poses })
}

/// C-style `%.9e`: two digits of exponent, sign always written.
fn scientific(x: f64) -> String {
    let text = format!("{x:.9e}");
    let (mantissa, exponent) = text.split_once('e').unwrap_or((&text, "0"));
    let exponent: i32 = exponent.parse().unwrap_or(0);
    let sign = if exponent < 0 { '-' } else { '+' };
    format!("{mantissa}e{sign}{:02}", exponent.abs())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn steps() -> Vec<Se3> {
        (0..7)
            .map(|i| {
                let x = f64::from(i);
                Se3::from_rotation_vector(
                    &Vector3::new(0.02 * x, -0.05, 0.01),
                    Vector3::new(0.1, 0.02 * x, -1.0),
                )
            })
            .collect()
    }

    fn gap(a: &Trajectory, b: &Trajectory) -> f64 {
        assert_eq!(a.len(), b.len());
        a.poses
            .iter()
            .zip(&b.poses)
            .map(|(a, b)| {
                assert_eq!(a.index, b.index);
                let (a, b) = (a.world_from_camera, b.world_from_camera);
                (a.rotation - b.rotation).abs().max() + (a.translation - b.translation).norm()
            })
            .fold(0.0, f64::max)
    }

    fn parse(text: &str) -> Result<Trajectory, GeometryError> {
        Trajectory::parse_kitti(text, Path::new("poses/04.txt"))
    }

    #[test]
    fn straight_driving_moves_forward() {
        // The source lies one metre ahead: its points are one metre nearer.
        let step = Se3::from_rotation_vector(&Vector3::zeros(), Vector3::new(0.0, 0.0, -1.0));
        let trajectory = Trajectory::accumulate(&[step; 3]);
        assert_eq!(trajectory.positions()[3], Vector3::new(0.0, 0.0, 3.0));
        assert_eq!(trajectory.path_length(), 3.0);
    }

    #[test]
    fn steps_come_back_from_the_trajectory() {
        let trajectory = Trajectory::accumulate(&steps());
        for (i, step) in steps().iter().enumerate() {
            let back = trajectory.source_from_target(i, i + 1).unwrap();
            assert!((back.rotation - step.rotation).abs().max() < 1e-14);
            assert!((back.translation - step.translation).norm() < 1e-13);
        }
        assert!(trajectory.source_from_target(0, 8).is_none());
    }

    #[test]
    fn both_file_forms_round_trip() {
        let trajectory = Trajectory::accumulate(&steps());
        for with_index in [false, true] {
            let back = parse(&trajectory.to_kitti(with_index)).unwrap();
            assert!(gap(&trajectory, &back) < 1e-8);
        }
        let back = Trajectory::parse_tum(&trajectory.to_tum(), Path::new("x")).unwrap();
        assert!(gap(&trajectory, &back) < 1e-8);
        assert_eq!(back.poses[3].stamp, Some(3.0));
    }

    #[test]
    fn kitti_numbers_are_written_like_c() {
        let text = Trajectory::accumulate(&[]).to_kitti(true);
        assert!(
            text.starts_with("0 1.000000000e+00 0.000000000e+00"),
            "{text}"
        );
        assert_eq!(scientific(-1.5e-7), "-1.500000000e-07");
    }

    #[test]
    fn indices_may_be_floats_and_out_of_order() {
        let identity = "1 0 0 0 0 1 0 0 0 0 1 0";
        let t = parse(&format!("3.0 {identity}\n\n# note\n1 {identity}\n")).unwrap();
        assert_eq!(t.poses.iter().map(|p| p.index).collect::<Vec<_>>(), [1, 3]);
        assert!(t.pose(3).is_some() && t.pose(2).is_none());
        let text = parse(&format!("3 {identity}\n3.0 {identity}"))
            .unwrap_err()
            .to_string();
        assert!(
            text.contains("04.txt:2") && text.contains("more than once"),
            "{text}"
        );
    }

    #[test]
    fn errors_name_file_line_and_cause() {
        let identity = "1 0 0 0 0 1 0 0 0 0 1 0";
        for (text, cause) in [
            (format!("{identity}\n1 2 3"), "3 numbers"),
            (format!("{identity}\n7 {identity}"), "13 numbers"),
            (
                format!("{identity}\n{}", identity.replacen('1', "1.1", 1)),
                "not a rotation",
            ),
            (
                format!("{identity}\n{}", identity.replacen('1', "nan", 1)),
                "`nan`",
            ),
        ] {
            let message = parse(&text).unwrap_err().to_string();
            assert!(
                message.contains("poses/04.txt:2") && message.contains(cause),
                "{message}"
            );
        }
        assert!(
            parse("# nothing\n")
                .unwrap_err()
                .to_string()
                .contains("no pose")
        );
        let message = parse(&format!("1.5 {identity}")).unwrap_err().to_string();
        assert!(message.contains("1.5"), "{message}");
    }

    #[test]
    fn tum_errors() {
        for (text, cause) in [
            ("0 0 0 0 0 0 0 1\n0 0 0 0 0 0 0 1", "does not come after"),
            ("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 2", "length 2"),
            ("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0", "7 numbers"),
        ] {
            let message = Trajectory::parse_tum(text, Path::new("a.tum"))
                .unwrap_err()
                .to_string();
            assert!(
                message.contains("a.tum:2") && message.contains(cause),
                "{message}"
            );
        }
        assert!(
            Trajectory::read_tum(Path::new("/nonexistent/x"))
                .unwrap_err()
                .to_string()
                .contains("/nonexistent/x")
        );
    }

    #[test]
    fn anchoring_puts_the_first_camera_at_the_origin() {
        let moved = Trajectory::from_poses(
            Trajectory::accumulate(&steps()).poses[2..]
                .iter()
                .map(|p| p.world_from_camera),
        );
        let anchored = moved.anchored_at_first();
        assert!(
            (anchored.poses[0].world_from_camera.rotation - Matrix3::identity())
                .abs()
                .max()
                < 1e-14
        );
        assert!((anchored.path_length() - moved.path_length()).abs() < 1e-12);
        assert!(Trajectory::default().anchored_at_first().is_empty());
    }
}
