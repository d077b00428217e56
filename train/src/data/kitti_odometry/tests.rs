//! The layout as it should be, and every way in which it may not be.

use super::*;
use crate::data::{Dataset, Image, snippet, write_depth_png, write_rgb_png};
use std::fs;

const POSE: &str = "1 0 0 0 0 1 0 0 0 0 1 0\n";

/// A layout with two sequences of four 24x12 frames.
fn layout() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in ["00", "06"] {
        let images = folder.path().join("sequences").join(name).join("image_0");
        fs::create_dir_all(&images).unwrap();
        for i in 0..4 {
            let image = Image::from_fn(1, 12, 24, |_, v, u| ((u + v + i) % 17) as f32 / 17.0);
            write_rgb_png(&images.join(format!("{i:06}.png")), &image).unwrap();
        }
        let calib = "P0: 20 0 11.5 0 0 21 5.5 0 0 0 1 0\nP1: 20 0 11.5 -10 0 21 5.5 0 0 0 1 0\n";
        fs::write(images.with_file_name("calib.txt"), calib).unwrap();
    }
    fs::create_dir(folder.path().join("poses")).unwrap();
    fs::write(folder.path().join("poses/06.txt"), POSE.repeat(4)).unwrap();
    folder
}

fn open(folder: &tempfile::TempDir) -> Result<FileDataset, DataError> {
    open_kitti_odometry(folder.path(), &LoadOptions::default())
}

fn message(folder: &tempfile::TempDir) -> String {
    open(folder).err().expect("the layout must be refused").to_string()
}

fn frame_path(folder: &tempfile::TempDir, name: &str) -> PathBuf {
    folder.path().join("sequences/06/image_0").join(name)
}

#[test]
fn opens_every_sequence_and_reads_frames() {
    let folder = layout();
    fs::write(folder.path().join("sequences/06/times.txt"), "0\n0.1\n0.2\n0.3\n").unwrap();
    let data = open(&folder).unwrap();
    assert_eq!((data.sequence_count(), data.sequence_name(1), data.sequence_len(1)), (2, "06".to_owned(), 4));
    assert_eq!(data.times(1), Some(&[0.0, 0.1, 0.2, 0.3][..]));
    assert!(data.times(0).is_none());
    let snippet = snippet(&data, 1, 2).unwrap();
    assert_eq!((snippet.target.name.as_str(), snippet.sources[1].name.as_str()), ("000002", "000003"));
    assert_eq!(snippet.target.image.channels, 3);
    assert_eq!((snippet.target.intrinsics.fv, snippet.target.intrinsics.width), (21.0, 24));
    assert!(snippet.target.world_from_camera.is_some() && snippet.target.depth.is_none());
    assert!(data.frame(0, 0).unwrap().world_from_camera.is_none());
}

#[test]
fn frames_are_resized_with_their_intrinsics_and_depth() {
    let folder = layout();
    let depth = folder.path().join("depth/06");
    fs::create_dir_all(&depth).unwrap();
    let map = crate::data::Map::from_vec(12, 24, vec![7.0; 288]);
    write_depth_png(&depth.join("000001.png"), &map).unwrap();
    let options =
        |center_crop| LoadOptions { size: Some((12, 12)), center_crop, sequences: vec!["6".into()], ..LoadOptions::default() };
    let squeezed = open_kitti_odometry(folder.path(), &options(false)).unwrap().frame(0, 1).unwrap();
    assert_eq!((squeezed.image.width, squeezed.image.height, squeezed.intrinsics.width), (12, 12, 12));
    assert_eq!((squeezed.intrinsics.fu, squeezed.intrinsics.fv, squeezed.intrinsics.u0), (10.0, 21.0, 5.5));
    assert_eq!(squeezed.depth.as_ref().unwrap().data, vec![7.0; 144]);
    let cropped = open_kitti_odometry(folder.path(), &options(true)).unwrap().frame(0, 1).unwrap();
    assert_eq!((cropped.image.width, cropped.image.height, cropped.intrinsics.fu, cropped.intrinsics.u0), (12, 12, 20.0, 5.5));
}

#[test]
fn frames_are_the_same_with_and_without_cache() {
    let folder = layout();
    let uncached = LoadOptions { cache_bytes: 0, ..LoadOptions::default() };
    let (a, b) = (open(&folder).unwrap(), open_kitti_odometry(folder.path(), &uncached).unwrap());
    for _ in 0..2 {
        assert_eq!(a.frame(0, 3).unwrap().image, b.frame(0, 3).unwrap().image);
    }
    assert!(std::sync::Arc::ptr_eq(&a.frame(0, 3).unwrap(), &a.frame(0, 3).unwrap()));
}

#[test]
fn numbers_outside_are_errors() {
    let data = open(&layout()).unwrap();
    assert_eq!(
        data.frame(2, 0).unwrap_err().to_string().split(": ").nth(1),
        Some("sequence 2 asked for, but there are 2 (0 to 1)")
    );
    assert!(data.frame(0, 4).unwrap_err().to_string().contains("frame 4 asked for, but there are 4 (0 to 3)"));
    assert!(snippet(&data, 0, 0).unwrap_err().to_string().contains("target frame 0 asked for"));
    assert!(snippet(&data, 0, 3).is_err() && snippet(&data, 5, 1).is_err());
}

#[test]
fn missing_parts_are_named() {
    let folder = tempfile::tempdir().unwrap();
    assert!(message(&folder).contains("sequences: `sequences` folder not found"));
    fs::create_dir_all(folder.path().join("sequences/00")).unwrap();
    assert!(message(&folder).contains("a sequence with frames in image_2 or image_0 not found"));
    let folder = layout();
    fs::remove_file(folder.path().join("sequences/06/calib.txt")).unwrap();
    assert!(message(&folder).contains("06/calib.txt: calibration file not found"));
    let wish = LoadOptions { sequences: vec!["09".into()], ..LoadOptions::default() };
    let refused = open_kitti_odometry(folder.path(), &wish).err().unwrap().to_string();
    assert!(refused.contains("sequence 09 with frames not found; choose among 00, 06"), "{refused}");
    let colour = LoadOptions { camera: Some(KittiCamera::LeftColour), ..LoadOptions::default() };
    let refused = open_kitti_odometry(folder.path(), &colour).err().unwrap().to_string();
    assert!(refused.contains("a sequence with frames in image_2 not found; choose a data.camera"), "{refused}");
}

#[test]
fn right_cameras_have_no_truth() {
    let folder = layout();
    for name in ["00", "06"] {
        let left = folder.path().join("sequences").join(name).join("image_0");
        fs::rename(&left, left.with_file_name("image_1")).unwrap();
    }
    let depth = folder.path().join("depth/06");
    fs::create_dir_all(&depth).unwrap();
    write_depth_png(&depth.join("000001.png"), &crate::data::Map::from_vec(12, 24, vec![7.0; 288])).unwrap();
    let right = LoadOptions { camera: Some(KittiCamera::RightGrey), ..LoadOptions::default() };
    let frame = open_kitti_odometry(folder.path(), &right).unwrap().frame(1, 1).unwrap();
    assert_eq!((frame.intrinsics.fv, frame.image.width), (21.0, 24));
    assert!(frame.depth.is_none() && frame.world_from_camera.is_none());
}

#[test]
fn every_wanted_sequence_has_a_name_and_is_named_once() {
    let folder = layout();
    let refused = |names: [&str; 2]| {
        let wish = LoadOptions { sequences: names.map(str::to_owned).into(), ..LoadOptions::default() };
        open_kitti_odometry(folder.path(), &wish).err().unwrap().to_string()
    };
    assert_eq!(refused(["06", "6"]), r#"sequences = ["06", "6"]: sequence 06 is named twice; name it once"#);
    let empty = refused(["00", ""]);
    assert!(empty.contains("a name is empty; name every sequence"), "{empty}");
}

#[test]
fn too_few_frames_are_refused() {
    let folder = layout();
    fs::remove_file(frame_path(&folder, "000003.png")).unwrap();
    fs::remove_file(frame_path(&folder, "000002.png")).unwrap();
    let message = message(&folder);
    assert!(message.contains("image_0: 2 frame(s) found, but training needs at least three frames"), "{message}");
}

#[test]
fn two_sizes_name_both_files() {
    let folder = layout();
    write_rgb_png(&frame_path(&folder, "000002.png"), &Image::zeros(1, 12, 25)).unwrap();
    let message = message(&folder);
    assert!(message.contains("000002.png: size 25x12, but "), "{message}");
    assert!(message.contains("000000.png is 24x12"), "{message}");
}

#[test]
fn a_truncated_frame_is_found_on_opening() {
    let folder = layout();
    let path = frame_path(&folder, "000001.png");
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    let message = message(&folder);
    assert!(message.contains("000001.png: truncated or damaged image"), "{message}");
}

#[test]
fn gaps_and_odd_names_are_refused() {
    let folder = layout();
    fs::rename(frame_path(&folder, "000003.png"), frame_path(&folder, "000005.png")).unwrap();
    assert!(message(&folder).contains("000005.png: frame 5 follows frame 2"));
    fs::rename(frame_path(&folder, "000005.png"), frame_path(&folder, "last.png")).unwrap();
    assert!(message(&folder).contains("last.png: bad frame number \"last\""));
}

#[test]
fn faults_of_the_poses_are_refused() {
    let folder = layout();
    let file = folder.path().join("poses/06.txt");
    let with = |text: String| {
        fs::write(&file, text).unwrap();
        message(&folder)
    };
    let counts = with(POSE.repeat(3));
    assert!(counts.contains("06.txt: 3 poses, but 4 frames in "), "{counts}");
    assert!(with(POSE.repeat(3) + &POSE.replacen('0', "nan", 1)).contains("06.txt:4: non-finite value nan"));
    assert!(with(POSE.repeat(3) + &POSE.replacen('1', "1.1", 1)).contains("06.txt:4: R^T R deviates from I by 2.1e-1"));
}

#[test]
fn faults_of_calibration_and_times_are_refused() {
    let folder = layout();
    let calib = folder.path().join("sequences/06/calib.txt");
    let good = fs::read_to_string(&calib).unwrap();
    fs::write(&calib, good.replace("P0: 20", "P0: 0")).unwrap();
    assert!(message(&folder).contains("calib.txt:1: P0: focal length fu = 0, expected a positive number"));
    fs::write(&calib, good).unwrap();
    let times = folder.path().join("sequences/06/times.txt");
    fs::write(&times, "0\n0.1\n0.1\n0.2\n").unwrap();
    assert!(message(&folder).contains("times.txt:3: not increasing (0.1 after 0.1)"));
    fs::write(&times, "0\n0.1\n").unwrap();
    assert!(message(&folder).contains("times.txt: 2 times, but 4 frames"));
}

#[test]
fn faults_that_appear_later_are_errors_of_the_frame() {
    let folder = layout();
    let data = open(&folder).unwrap();
    write_rgb_png(&frame_path(&folder, "000001.png"), &Image::zeros(1, 9, 9)).unwrap();
    let message = data.frame(1, 1).unwrap_err().to_string();
    assert!(message.contains("000001.png: size 9x9, it was 24x12"), "{message}");
    let depth = folder.path().join("depth/00");
    fs::create_dir_all(&depth).unwrap();
    write_depth_png(&depth.join("000000.png"), &crate::data::Map::zeros(3, 3)).unwrap();
    let message = open_kitti_odometry(folder.path(), &LoadOptions { sequences: vec!["00".into()], ..LoadOptions::default() })
        .unwrap()
        .frame(0, 0)
        .unwrap_err()
        .to_string();
    assert!(message.contains("000000.png: depth 3x3, image 24x12"), "{message}");
}

#[test]
fn an_impossible_size_is_a_wrong_option() {
    let options = LoadOptions { size: Some((0, 64)), ..LoadOptions::default() };
    let message = open_kitti_odometry(Path::new("x"), &options).err().unwrap().to_string();
    assert!(message.starts_with("size = 0x64: both sides must be 1 to 16384"), "{message}");
}

#[test]
fn real_frames_open_with_poses_and_scaled_intrinsics() {
    let root = std::env::var_os("DIMODE_DATA")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"), PathBuf::from);
    let sample = root.join("kitti_sample");
    if !sample.is_dir() {
        eprintln!("skipped: no kitti_sample in {} (set DIMODE_DATA)", root.display());
        return;
    }
    let options = LoadOptions { size: Some((128, 64)), ..LoadOptions::default() };
    let data = open_kitti_odometry(&sample, &options).unwrap();
    assert_eq!((data.sequence_count(), data.sequence_name(0), data.sequence_len(0)), (1, "06".to_owned(), 51));
    let (first, last) = (data.frame(0, 0).unwrap(), data.frame(0, 50).unwrap());
    assert_eq!((first.image.width, first.image.height), (128, 64));
    assert!((first.intrinsics.fu - 707.0912 * 128.0 / 1226.0).abs() < 1e-9);
    assert!((first.intrinsics.fv - 707.0912 * 64.0 / 370.0).abs() < 1e-9);
    assert!((first.intrinsics.u0 - (602.3873 * 128.0 / 1226.0 - 0.5)).abs() < 1e-9);
    let (start, end) = (first.world_from_camera.unwrap(), last.world_from_camera.unwrap());
    let displacement = (end.translation - start.translation).norm();
    assert!((displacement - 59.858).abs() < 1e-3, "net displacement {displacement}");
    let mean = first.image.data.iter().sum::<f32>() / first.image.data.len() as f32;
    assert!((0.1..0.9).contains(&mean), "mean brightness {mean}");
}
