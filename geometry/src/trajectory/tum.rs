//! The TUM form: time, position and quaternion.

use std::path::Path;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use super::text::{content_lines, numbers, ordered, parse_error, read, scientific};
use super::{QUATERNION_TOLERANCE, StampedPose, Trajectory};
use crate::error::GeometryError;
use crate::se3::Se3;

impl Trajectory {
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
            let Ok([stamp, x, y, z, qx, qy, qz, qw]) = <[f64; 8]>::try_from(numbers.as_slice()) else {
                return Err(fail(format!("{} numbers, expected 8: stamp tx ty tz qx qy qz qw", numbers.len())));
            };
            if poses.last().and_then(|p| p.stamp).is_some_and(|last| stamp <= last) {
                return Err(fail(format!("stamp {stamp} does not come after the one before")));
            }
            let q = Quaternion::new(qw, qx, qy, qz);
            if (q.norm() - 1.0).abs() > QUATERNION_TOLERANCE {
                return Err(fail(format!("quaternion of length {:.6}, expected 1", q.norm())));
            }
            let rotation = UnitQuaternion::new_normalize(q).to_rotation_matrix().into_inner();
            poses.push(StampedPose {
                index: poses.len(),
                stamp: Some(stamp),
                world_from_camera: Se3 { rotation, translation: Vector3::new(x, y, z) },
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
            let fields: Vec<String> = [t.x, t.y, t.z, q.i, q.j, q.k, q.w].iter().map(|&x| scientific(x)).collect();
            text.push_str(&format!("{stamp:.9} {}\n", fields.join(" ")));
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{gap, steps};
    use super::*;

    #[test]
    fn round_trip() {
        let trajectory = Trajectory::accumulate(&steps());
        let back = Trajectory::parse_tum(&trajectory.to_tum(), Path::new("x")).unwrap();
        assert!(gap(&trajectory, &back) < 1e-8);
        assert_eq!(back.poses[3].stamp, Some(3.0));
    }

    #[test]
    fn tum_errors() {
        for (text, cause) in [
            ("0 0 0 0 0 0 0 1\n0 0 0 0 0 0 0 1", "does not come after"),
            ("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 2", "length 2"),
            ("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0", "7 numbers"),
        ] {
            let message = Trajectory::parse_tum(text, Path::new("a.tum")).unwrap_err().to_string();
            assert!(message.contains("a.tum:2") && message.contains(cause), "{message}");
        }
        assert!(Trajectory::read_tum(Path::new("/nonexistent/x")).unwrap_err().to_string().contains("/nonexistent/x"));
    }
}
