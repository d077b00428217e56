//! Writes any dataset in the KITTI odometry layout, with depth, flow and poses where they are known.
//!
//! ```text
//! ROOT/sequences/NN/image_2/%06d.png   8-bit colour
//! ROOT/sequences/NN/calib.txt          P0 to P3, all the same camera
//! ROOT/sequences/NN/times.txt          seconds
//! ROOT/poses/NN.txt                    world from camera, the first camera is the world
//! ROOT/depth/NN/%06d.png               16-bit, metres * 256, 0 unknown
//! ROOT/flow/NN/%06d.png                KITTI flow from this frame to the next one, valid where the next frame sees the point
//! ```
//!
//! A hidden file `.dimode` tells that the folder was made here.

use std::fs;
use std::path::Path;

use dimode_geometry::Se3;

use super::calib::format_projection;
use super::staging::{Earlier, Staging};
use super::{DataError, Dataset, Frame, encode_depth_png, encode_flow_png, encode_rgb_png, format_poses};

/// Seconds between frames of a dataset that does not tell its times: the 10 Hz of KITTI.
const FRAME_TIME: f64 = 0.1;
/// The folders of the layout.
const LAYOUT: [&str; 4] = ["sequences", "poses", "depth", "flow"];

/// What [`write_kitti`] has written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WriteSummary {
    /// Sequences.
    pub sequences: usize,
    /// Frames.
    pub frames: usize,
    /// Depth maps.
    pub depth_maps: usize,
    /// Flow maps.
    pub flow_maps: usize,
    /// Pose files.
    pub pose_files: usize,
}

/// Writes all of a dataset to the folder `root`, by way of `root.partial` and a rename, so `root` appears complete or not at
/// all. `overwrite` allows to replace a folder that this function wrote. After each frame `progress` is told (frames done, all
/// frames); an error from it ends the work.
///
/// **Errors** [`DataError::Occupied`] when `root` was written here and `overwrite` is not set, [`DataError::NotOurs`] when it was
/// not written here or holds anything that is not of this layout; [`DataError::Write`] when the system refuses; errors of the
/// dataset and of `progress`. What was begun is removed.
pub fn write_kitti<E: From<DataError>>(
    dataset: &dyn Dataset,
    root: &Path,
    overwrite: bool,
    progress: &mut dyn FnMut(usize, usize) -> Result<(), E>,
) -> Result<WriteSummary, E> {
    let staging = Staging::new(root, Earlier::Replace { entries: &LAYOUT, asked: overwrite })?;
    staging.fill(|folder| write_all(dataset, folder, progress))
}

fn write_all<E: From<DataError>>(
    dataset: &dyn Dataset,
    root: &Path,
    progress: &mut dyn FnMut(usize, usize) -> Result<(), E>,
) -> Result<WriteSummary, E> {
    let count = dataset.sequence_count();
    let total = (0..count).map(|s| dataset.sequence_len(s)).sum();
    let mut writer = Writer { dataset, root, summary: WriteSummary::default() };
    for sequence in 0..count {
        writer.write_sequence(sequence, &mut |done| progress(done, total))?;
    }
    Ok(writer.summary)
}

fn make_folder(folder: &Path) -> Result<(), DataError> {
    fs::create_dir_all(folder).map_err(|error| DataError::write(folder, error))
}

fn write_file(path: &Path, bytes: &[u8]) -> Result<(), DataError> {
    fs::write(path, bytes).map_err(|error| DataError::write(path, error))
}

struct Writer<'a> {
    dataset: &'a dyn Dataset,
    root: &'a Path,
    summary: WriteSummary,
}

impl Writer<'_> {
    fn write_sequence<E: From<DataError>>(
        &mut self,
        sequence: usize,
        progress: &mut dyn FnMut(usize) -> Result<(), E>,
    ) -> Result<(), E> {
        let name = format!("{sequence:02}");
        let len = self.dataset.sequence_len(sequence);
        let folder = self.root.join("sequences").join(&name);
        make_folder(&folder.join("image_2"))?;
        let mut poses = Vec::new();
        for index in 0..len {
            let frame = self.dataset.frame(sequence, index)?;
            if index == 0 {
                let calib: String = (0..4).map(|n| format_projection(&format!("P{n}"), &frame.intrinsics)).collect();
                write_file(&folder.join("calib.txt"), calib.as_bytes())?;
            }
            poses.extend(frame.world_from_camera);
            self.write_frame(&name, index, &frame)?;
            if index + 1 < len {
                self.write_flow(&name, sequence, index)?;
            }
            progress(self.summary.frames)?;
        }
        write_file(&folder.join("times.txt"), self.times(sequence, len).as_bytes())?;
        if len > 0 && poses.len() == len {
            self.write_poses(&name, &poses)?;
        }
        self.summary.sequences += 1;
        Ok(())
    }

    fn write_frame(&mut self, name: &str, index: usize, frame: &Frame) -> Result<(), DataError> {
        let file = format!("{index:06}.png");
        let images = self.root.join("sequences").join(name).join("image_2");
        write_file(&images.join(&file), &encode_rgb_png(&frame.image))?;
        self.summary.frames += 1;
        if let Some(depth) = &frame.depth {
            let folder = self.root.join("depth").join(name);
            make_folder(&folder)?;
            write_file(&folder.join(&file), &encode_depth_png(depth))?;
            self.summary.depth_maps += 1;
        }
        Ok(())
    }

    fn write_flow(&mut self, name: &str, sequence: usize, index: usize) -> Result<(), DataError> {
        if let Some(truth) = self.dataset.pair_truth(sequence, index, index + 1)? {
            let folder = self.root.join("flow").join(name);
            make_folder(&folder)?;
            let bytes = encode_flow_png(&truth.flow, &truth.visible);
            write_file(&folder.join(format!("{index:06}.png")), &bytes)?;
            self.summary.flow_maps += 1;
        }
        Ok(())
    }

    fn write_poses(&mut self, name: &str, poses: &[Se3]) -> Result<(), DataError> {
        let first_from_world = poses[0].inverse();
        let relative: Vec<Se3> = poses.iter().map(|pose| first_from_world.compose(pose)).collect();
        let folder = self.root.join("poses");
        make_folder(&folder)?;
        write_file(&folder.join(format!("{name}.txt")), format_poses(&relative).as_bytes())?;
        self.summary.pose_files += 1;
        Ok(())
    }

    fn times(&self, sequence: usize, len: usize) -> String {
        let known = self.dataset.times(sequence);
        let time = |index: usize| known.map_or(index as f64 * FRAME_TIME, |times| times[index]);
        (0..len).map(|index| format!("{}\n", super::text::scientific(time(index), 6))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::{FlowMap, Image, LoadOptions, Map, PairTruth, open_kitti_odometry, read_flow_png};
    use dimode_geometry::Intrinsics;
    use nalgebra::Vector3;
    use std::sync::Arc;

    /// Two sequences of four frames; frame 2 of sequence 1 fails when asked to.
    struct Made {
        fails: bool,
    }

    impl Dataset for Made {
        fn name(&self) -> String {
            "made".into()
        }
        fn sequence_count(&self) -> usize {
            2
        }
        fn sequence_name(&self, sequence: usize) -> String {
            format!("world {sequence}")
        }
        fn sequence_len(&self, _: usize) -> usize {
            4
        }
        fn frame_name(&self, _: usize, frame: usize) -> String {
            format!("{frame:06}")
        }

        fn frame(&self, s: usize, f: usize) -> Result<Arc<Frame>, DataError> {
            if self.fails && (s, f) == (1, 2) {
                return Err(DataError::malformed(Path::new("made"), "fails", "nothing"));
            }
            let omega = Vector3::new(0.0, 0.1 * f as f64, 0.02);
            Ok(Arc::new(Frame {
                image: Image::from_fn(3, 8, 16, |c, v, u| ((c + 3 * v + 5 * u + 7 * f + s) % 256) as f32 / 255.0),
                intrinsics: Intrinsics::new(14.25, 15.5, 7.7, 3.4, 16, 8).unwrap(),
                depth: Some(Map::from_vec(8, 16, (0..128).map(|i| i as f32 / 4.0).collect())),
                world_from_camera: Some(Se3::from_rotation_vector(&omega, Vector3::new(5.0, 0.0, 1.0 + f as f64))),
                name: format!("{f}"),
            }))
        }
        fn pair_truth(&self, _: usize, target: usize, source: usize) -> Result<Option<PairTruth>, DataError> {
            assert_eq!(source, target + 1);
            let flow = FlowMap { height: 8, width: 16, u: vec![1.5; 128], v: vec![target as f32; 128] };
            let visible = (0..128).map(|i| i % 3 != 0).collect();
            Ok(Some(PairTruth { source_from_target: Se3::identity(), flow, visible }))
        }
    }

    fn write(fails: bool, root: &Path, overwrite: bool) -> Result<WriteSummary, DataError> {
        write_kitti(&Made { fails }, root, overwrite, &mut |_, _| Ok(()))
    }

    #[test]
    fn what_is_written_reads_back() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().join("out");
        let mut steps = Vec::new();
        let mut told = |done, all| {
            steps.push((done, all));
            Ok::<_, DataError>(())
        };
        let summary = write_kitti(&Made { fails: false }, &root, false, &mut told).unwrap();
        assert_eq!(summary, WriteSummary { sequences: 2, frames: 8, depth_maps: 8, flow_maps: 6, pose_files: 2 });
        assert_eq!((steps[0], steps[7]), ((1, 8), (8, 8)));
        let made = Made { fails: false };
        let data = open_kitti_odometry(&root, &LoadOptions::default()).unwrap();
        assert_eq!((data.sequence_count(), data.sequence_len(1)), (2, 4));
        let start = made.frame(1, 0).unwrap().world_from_camera.unwrap();
        for index in 0..4 {
            let (old, new) = (made.frame(1, index).unwrap(), data.frame(1, index).unwrap());
            assert_eq!(old.image, new.image);
            assert_eq!(old.depth, new.depth);
            assert_eq!(old.intrinsics, new.intrinsics);
            let relative = start.inverse().compose(&old.world_from_camera.unwrap());
            let pose = new.world_from_camera.unwrap();
            assert!((relative.rotation - pose.rotation).amax() < 1e-11);
            assert!((relative.translation - pose.translation).amax() < 1e-11);
        }
        assert_eq!(data.times(0).unwrap()[3], 0.3);
        let flow = read_flow_png(&root.join("flow/01/000002.png")).unwrap();
        assert_eq!((flow.flow.u[1], flow.flow.v[1], flow.known[0], flow.known[1]), (1.5, 2.0, false, true));
        assert!(!root.join("flow/01/000003.png").exists());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_failure_leaves_nothing_behind() {
        let folder = tempfile::tempdir().unwrap();
        assert!(write(true, &folder.path().join("out"), false).is_err());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn a_failure_keeps_the_old_folder() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().join("out");
        write(false, &root, false).unwrap();
        assert!(write(true, &root, true).is_err());
        assert!(root.join("sequences/01/image_2/000003.png").exists());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_filled_folder_is_replaced_only_on_request() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().join("out");
        fs::create_dir(&root).unwrap();
        write(false, &root, false).unwrap();
        let message = write(false, &root, false).unwrap_err().to_string();
        assert!(message.contains("out: already written") && message.contains("add --force"), "{message}");
        fs::create_dir_all(root.join("sequences/77")).unwrap();
        write(false, &root, true).unwrap();
        assert!(!root.join("sequences/77").exists());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
