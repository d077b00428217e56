//! Files beside the report. Each appears whole or not at all.

use std::path::{Path, PathBuf};

use dimode_geometry::Trajectory;
use serde::Serialize;

use super::ReportError;
use crate::data::{Map, write_atomic, write_depth_png};

/// Writes any result as indented JSON with a line end; the keys are those of the type.
///
/// **Errors** when the value has no JSON form or the file cannot be written.
pub fn write_json(path: &Path, value: &impl Serialize) -> Result<(), ReportError> {
    let mut bytes = serde_json::to_vec_pretty(value).map_err(|source| ReportError::Json { path: path.to_owned(), source })?;
    bytes.push(b'\n');
    Ok(write_atomic(path, &bytes)?)
}

/// Writes a trajectory as `NAME.kitti.txt` (12 numbers a line, or 13 with the frame index first unless the frames are 0, 1,
/// 2 and so on) and `NAME.tum.txt` (time or frame index, position, quaternion) into a folder; gives both paths.
///
/// **Errors** when a file cannot be written.
pub fn write_trajectory(folder: &Path, name: &str, trajectory: &Trajectory) -> Result<[PathBuf; 2], ReportError> {
    let gaps = trajectory.poses.iter().enumerate().any(|(i, pose)| pose.index != i);
    let kitti = folder.join(format!("{name}.kitti.txt"));
    let tum = folder.join(format!("{name}.tum.txt"));
    write_atomic(&kitti, trajectory.to_kitti(gaps).as_bytes())?;
    write_atomic(&tum, trajectory.to_tum().as_bytes())?;
    Ok([kitti, tum])
}

/// Writes depth in metres as a 16-bit grey PNG with 256 steps a metre, 0 unknown; 255.99 m and all beyond are the
/// largest number.
///
/// **Errors** when the file cannot be written.
pub fn write_depth_png16(path: &Path, depth: &Map) -> Result<(), ReportError> {
    const LARGEST: f32 = 65535.0 / 256.0;
    let cut = depth.data.iter().map(|&d| if d > LARGEST { LARGEST } else { d }).collect();
    Ok(write_depth_png(path, &Map { data: cut, ..*depth })?)
}

#[cfg(test)]
mod tests {
    use dimode_geometry::Se3;
    use nalgebra::Vector3;

    use super::*;

    fn drive() -> Trajectory {
        Trajectory::from_poses((0..5).map(|i| {
            let w = Vector3::new(0.0, 0.1 * f64::from(i), 0.0);
            Se3::from_rotation_vector(&w, Vector3::new(0.0, 0.0, f64::from(i)))
        }))
    }

    #[test]
    fn trajectories_come_back_in_both_forms() {
        let folder = tempfile::tempdir().unwrap();
        let mut trajectory = drive();
        let [kitti, tum] = write_trajectory(folder.path(), "seq", &trajectory).unwrap();
        let first_line = std::fs::read_to_string(&kitti).unwrap().lines().next().unwrap().to_owned();
        assert_eq!(first_line.split_whitespace().count(), 12);
        for back in [Trajectory::read_kitti(&kitti).unwrap(), Trajectory::read_tum(&tum).unwrap()] {
            assert_eq!(back.poses.len(), 5);
            for (a, b) in back.poses.iter().zip(&trajectory.poses) {
                assert!((a.world_from_camera.translation - b.world_from_camera.translation).norm() < 1e-6);
                assert!((a.world_from_camera.rotation - b.world_from_camera.rotation).norm() < 1e-5);
            }
        }
        trajectory.poses.remove(2);
        let [kitti, _] = write_trajectory(folder.path(), "gap", &trajectory).unwrap();
        let back = Trajectory::read_kitti(&kitti).unwrap();
        assert_eq!(back.poses.iter().map(|p| p.index).collect::<Vec<_>>(), [0, 1, 3, 4]);
    }

    #[test]
    fn depth_comes_back_to_half_a_step() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("depth.png");
        let depth = Map { height: 1, width: 3, data: vec![0.0, 1.234, 400.0] };
        write_depth_png16(&path, &depth).unwrap();
        let back = image::open(&path).unwrap().to_luma16();
        for (got, want) in back.as_raw().iter().zip(&depth.data) {
            assert!((f32::from(*got) / 256.0 - want.min(65535.0 / 256.0)).abs() <= 0.5 / 256.0 + 1e-6);
        }
    }

    #[test]
    fn a_missing_folder_is_a_clear_error() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("none").join("metrics.json");
        let message = write_json(&path, &[1, 2]).unwrap_err().to_string();
        assert!(message.contains("metrics.json") && message.contains("cannot be written"), "{message}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
