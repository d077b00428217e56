//! Pose files in the KITTI form: one row of twelve numbers a frame, the upper 3x4 of `world_from_camera`.

use std::path::Path;

use dimode_geometry::Se3;
use nalgebra::{Matrix3, Vector3};

use super::DataError;
use super::text::{filled_lines, parse_numbers, read_text, scientific};

/// Largest entry of R^T R - I that is still taken for a rotation written with few digits.
const ORTHONORMAL_LIMIT: f64 = 1e-4;
/// Deviations above this (and below the limit) are repaired by taking the nearest rotation.
const ORTHONORMAL_EXACT: f64 = 1e-6;

/// Reads a KITTI pose file: each row maps camera points to the world.
///
/// **Errors** as [`parse_poses`], and when the file cannot be read.
pub fn read_poses(path: &Path) -> Result<Vec<Se3>, DataError> {
    parse_poses(path, &read_text(path, "pose file")?)
}

/// Poses from the text of a KITTI pose file; `path` only names the file in errors. A row may start with its frame number,
/// then all rows must, counting from 0.
///
/// **Errors** name the line: wrong count, no number, non-finite value, R not orthonormal within 1e-4, determinant -1.
/// Rotations off by 1e-6 to 1e-4 are replaced by the nearest rotation.
pub fn parse_poses(path: &Path, text: &str) -> Result<Vec<Se3>, DataError> {
    let mut poses = Vec::new();
    let mut width = None;
    for (line, content) in filled_lines(text) {
        let numbers = parse_numbers(path, line, content)?;
        let found = numbers.len();
        let expected = *width.get_or_insert(found);
        if !matches!(found, 12 | 13) || found != expected {
            let reason = format!("{found} numbers, expected 12 (or 13 with a frame index), the same in every row");
            return Err(DataError::at_line(path, line, reason, ROW_ADVICE));
        }
        if found == 13 && numbers[0] != poses.len() as f64 {
            let reason = format!("frame index {}, expected {}", numbers[0], poses.len());
            return Err(DataError::at_line(path, line, reason, "number the rows from 0 without gaps"));
        }
        poses.push(pose_of_row(path, line, &numbers[found - 12..])?);
    }
    Ok(poses)
}

const ROW_ADVICE: &str = "each row is the 3x4 matrix [R t] of the camera in the world, row by row";

fn pose_of_row(path: &Path, line: usize, row: &[f64]) -> Result<Se3, DataError> {
    let rotation = Matrix3::new(row[0], row[1], row[2], row[4], row[5], row[6], row[8], row[9], row[10]);
    let translation = Vector3::new(row[3], row[7], row[11]);
    let deviation = deviation_from_rotation(&rotation);
    if deviation > ORTHONORMAL_LIMIT {
        let reason = format!("R^T R deviates from I by {deviation:.1e} (limit {ORTHONORMAL_LIMIT:.0e})");
        return Err(DataError::at_line(path, line, reason, ROW_ADVICE));
    }
    if rotation.determinant() < 0.0 {
        return Err(DataError::at_line(path, line, "det R = -1, not a rotation", ROW_ADVICE));
    }
    let pose = Se3 { rotation, translation };
    Ok(if deviation > ORTHONORMAL_EXACT { pose.orthonormalised() } else { pose })
}

/// Largest entry of |R^T R - I|; infinite when the product overflows.
fn deviation_from_rotation(rotation: &Matrix3<f64>) -> f64 {
    let difference = rotation.transpose() * rotation - Matrix3::identity();
    difference.iter().fold(0.0, |largest: f64, x| if x.is_nan() { f64::INFINITY } else { largest.max(x.abs()) })
}

/// The text of a KITTI pose file, twelve numbers a row in scientific notation with 12 digits after the point.
pub fn format_poses(poses: &[Se3]) -> String {
    let mut text = String::new();
    for pose in poses {
        let row: Vec<String> = (0..12)
            .map(|i| {
                let (r, c) = (i / 4, i % 4);
                scientific(if c == 3 { pose.translation[r] } else { pose.rotation[(r, c)] }, 12)
            })
            .collect();
        text.push_str(&row.join(" "));
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const IDENTITY: &str = "1 0 0 0 0 1 0 0 0 0 1 0";

    fn message(text: &str) -> String {
        parse_poses(Path::new("poses/09.txt"), text).unwrap_err().to_string()
    }

    #[test]
    fn rows_become_poses() {
        let poses = parse_poses(Path::new("p"), "0 0 1 5\t0 1 0 6 -1 0 0 7\r\n").unwrap();
        assert_eq!(poses.len(), 1);
        assert_eq!(poses[0].translation, Vector3::new(5.0, 6.0, 7.0));
        assert_eq!(poses[0].transform(&Vector3::new(1.0, 2.0, 3.0)), Vector3::new(8.0, 8.0, 6.0));
    }

    #[test]
    fn a_frame_index_in_front_is_accepted_when_every_row_has_it() {
        let text = format!("0 {IDENTITY}\n1 {IDENTITY}\n");
        assert_eq!(parse_poses(Path::new("p"), &text).unwrap().len(), 2);
        let text = format!("0 {IDENTITY}\n{IDENTITY}\n");
        assert!(message(&text).starts_with("poses/09.txt:2: 12 numbers, expected 12 (or 13"));
        let text = format!("0 {IDENTITY}\n2 {IDENTITY}\n");
        assert!(message(&text).starts_with("poses/09.txt:2: frame index 2, expected 1"));
    }

    #[test]
    fn faults_name_the_line_and_the_value() {
        let second = |row: &str| message(&format!("{IDENTITY}\n{row}\n"));
        assert!(second("1 0 0 0 0 1 0 0 0 0 1").starts_with("poses/09.txt:2: 11 numbers, expected 12"));
        assert!(second("1 0 0 nan 0 1 0 0 0 0 1 0").starts_with("poses/09.txt:2: non-finite value nan"));
        assert!(second("1 0 0 x 0 1 0 0 0 0 1 0").starts_with("poses/09.txt:2: \"x\" is not a number"));
        assert!(second("1.01 0 0 0 0 1 0 0 0 0 1 0").starts_with("poses/09.txt:2: R^T R deviates from I by 2.0e-2"));
        assert!(second("1e300 0 0 0 0 1 0 0 0 0 1 0").contains("R^T R deviates"));
        assert!(second("-1 0 0 0 0 1 0 0 0 0 1 0").starts_with("poses/09.txt:2: det R = -1"));
    }

    #[test]
    fn small_deviations_are_repaired() {
        let poses = parse_poses(Path::new("p"), "1.00002 0 0 0 0 1 0 0 0 0 1 0").unwrap();
        assert!((poses[0].rotation - Matrix3::identity()).amax() < 1e-12);
    }

    #[test]
    fn format_reads_back() {
        let poses =
            vec![Se3::identity(), Se3::from_rotation_vector(&Vector3::new(0.1, -0.2, 0.3), Vector3::new(1.0, -2.0, 1e-5))];
        let again = parse_poses(Path::new("p"), &format_poses(&poses)).unwrap();
        for (a, b) in poses.iter().zip(&again) {
            assert!((a.rotation - b.rotation).amax() < 1e-12);
            assert!((a.translation - b.translation).amax() < 1e-12);
        }
    }

    proptest! {
        #[test]
        fn any_text_is_an_error_or_rotations(text in "[-0-9eE. naif\n]{0,200}") {
            if let Ok(poses) = parse_poses(Path::new("p"), &text) {
                prop_assert!(poses.iter().all(|p| p.is_orthonormal(1e-3)));
            }
        }

        #[test]
        fn any_twelve_numbers_are_an_error_or_a_rotation(row in prop::collection::vec(any::<f64>(), 12)) {
            let text = row.iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
            if let Ok(poses) = parse_poses(Path::new("p"), &text) {
                prop_assert!(poses[0].is_orthonormal(1e-3));
            }
        }
    }
}
