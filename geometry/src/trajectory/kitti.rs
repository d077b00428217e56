//! The KITTI form: 3x4 matrices row by row, with or without a frame index.

use std::path::Path;

use nalgebra::{Matrix3, Vector3};

use super::text::{content_lines, numbers, ordered, parse_error, read, scientific, write};
use super::{ROTATION_TOLERANCE, StampedPose, Trajectory};
use crate::error::GeometryError;
use crate::se3::Se3;

impl Trajectory {
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
            let world_from_camera =
                kitti_pose(row).checked("KITTI pose row", ROTATION_TOLERANCE).map_err(|e| fail(e.to_string()))?;
            lines.push(line);
            poses.push(StampedPose { index, stamp: None, world_from_camera });
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
    Err(format!("frame index {value} is not a whole number from 0 up"))
}

fn kitti_pose(row: &[f64]) -> Se3 {
    Se3 { rotation: Matrix3::from_fn(|r, c| row[4 * r + c]), translation: Vector3::from_fn(|r, _| row[4 * r + 3]) }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{gap, steps};
    use super::*;

    fn parse(text: &str) -> Result<Trajectory, GeometryError> {
        Trajectory::parse_kitti(text, Path::new("poses/04.txt"))
    }

    #[test]
    fn round_trip() {
        let trajectory = Trajectory::accumulate(&steps());
        for with_index in [false, true] {
            let back = parse(&trajectory.to_kitti(with_index)).unwrap();
            assert!(gap(&trajectory, &back) < 1e-8);
        }
        let text = Trajectory::accumulate(&[]).to_kitti(true);
        assert!(text.starts_with("0 1.000000000e+00 0.000000000e+00"), "{text}");
    }

    #[test]
    fn indices_may_be_floats_and_out_of_order() {
        let identity = "1 0 0 0 0 1 0 0 0 0 1 0";
        let t = parse(&format!("3.0 {identity}\n\n# note\n1 {identity}\n")).unwrap();
        assert_eq!(t.poses.iter().map(|p| p.index).collect::<Vec<_>>(), [1, 3]);
        assert!(t.pose(3).is_some() && t.pose(2).is_none());
        let text = parse(&format!("3 {identity}\n3.0 {identity}")).unwrap_err().to_string();
        assert!(text.contains("04.txt:2") && text.contains("more than once"), "{text}");
    }

    #[test]
    fn errors_name_file_line_and_cause() {
        let identity = "1 0 0 0 0 1 0 0 0 0 1 0";
        for (text, cause) in [
            (format!("{identity}\n1 2 3"), "3 numbers"),
            (format!("{identity}\n7 {identity}"), "13 numbers"),
            (format!("{identity}\n{}", identity.replacen('1', "1.1", 1)), "not a rotation"),
            (format!("{identity}\n{}", identity.replacen('1', "nan", 1)), "`nan`"),
        ] {
            let message = parse(&text).unwrap_err().to_string();
            assert!(message.contains("poses/04.txt:2") && message.contains(cause), "{message}");
        }
        assert!(parse("# nothing\n").unwrap_err().to_string().contains("no pose"));
        let message = parse(&format!("1.5 {identity}")).unwrap_err().to_string();
        assert!(message.contains("1.5"), "{message}");
    }
}
