//! Any folder of frames with an intrinsics file.
//!
//! ```text
//! ROOT/*.png|*.jpg  or  ROOT/images/*.png|*.jpg    frames in the order of their names
//! ROOT/intrinsics.txt  or  ROOT/intrinsics.toml    the camera, see `intrinsics_file`
//! ROOT/poses.txt                                   optional, KITTI rows, for evaluation
//! ROOT/times.txt                                   optional, seconds, one a line
//! ```
//!
//! A folder without frames of its own may hold several such folders, one a sequence; a sequence without an intrinsics file
//! uses that of the folder above.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use dimode_geometry::Intrinsics;

use super::DataError;
use super::file_dataset::{FileDataset, FileSequence, check_count, choose, common_size, image_files, last_part, sorted_entries};
use super::intrinsics_file::{EXAMPLE, IntrinsicsFile};
use super::options::LoadOptions;
use super::poses::read_poses;
use super::times::read_times;

/// Opens a folder of frames, or a folder of such folders, and checks all of it but the pixels.
///
/// **Errors** name the file: no frames, fewer than asked for, two of one name, different sizes, truncated files; a missing intrinsics file (with
/// an example of one) where the camera is needed, its faults, intrinsics of another shape; faults of the poses and times and counts that differ.
pub fn open_folder(root: &Path, options: &LoadOptions) -> Result<FileDataset, DataError> {
    options.check()?;
    let folders = sequence_folders(root, &options.sequences)?;
    let sequences = folders.iter().map(|folder| open_sequence(root, folder, options)).collect::<Result<Vec<_>, _>>()?;
    Ok(FileDataset::new(last_part(root), sequences, options))
}

/// Where the frames of a sequence folder lie: in `images` or in the folder itself; `None` when there are none.
fn frames_folder(folder: &Path) -> Result<Option<PathBuf>, DataError> {
    for candidate in [folder.join("images"), folder.to_owned()] {
        if candidate.is_dir() && !image_files(&candidate)?.is_empty() {
            return Ok(Some(candidate));
        }
    }
    Ok(None)
}

/// Whether [`open_folder`] would find a frame.
pub(crate) fn has_frames(root: &Path) -> Result<bool, DataError> {
    Ok(!all_sequence_folders(root)?.is_empty())
}

/// The folder itself when it has frames, else those of its folders that have some.
fn all_sequence_folders(root: &Path) -> Result<Vec<PathBuf>, DataError> {
    if frames_folder(root)?.is_some() {
        return Ok(vec![root.to_owned()]);
    }
    let mut found = Vec::new();
    for entry in sorted_entries(root, "data folder")? {
        if entry.is_dir() && frames_folder(&entry)?.is_some() {
            found.push(entry);
        }
    }
    Ok(found)
}

fn sequence_folders(root: &Path, wanted: &[String]) -> Result<Vec<PathBuf>, DataError> {
    let all = all_sequence_folders(root)?;
    if all.is_empty() {
        let advice = "put PNG or JPEG frames into the folder, or name another one".to_owned();
        return Err(DataError::Missing { path: root.to_owned(), what: "a frame (PNG or JPEG)".to_owned(), advice });
    }
    choose(root, all, wanted, |folder, name| folder == name)
}

fn open_sequence(root: &Path, folder: &Path, options: &LoadOptions) -> Result<FileSequence, DataError> {
    let images = frames_folder(folder)?.unwrap_or_else(|| folder.to_owned());
    let files = image_files(&images)?;
    check_names(&files)?;
    let (width, height) = common_size(&images, &files, options.min_frames)?;
    let intrinsics = match intrinsics_path(root, folder) {
        Err(_) if !options.needs_camera => stand_in(width, height),
        path => path.and_then(|path| IntrinsicsFile::read(&path)?.camera(&path, width, height))?,
    };
    let pose_file = folder.join("poses.txt");
    let poses = if pose_file.exists() { Some(read_poses(&pose_file)?) } else { None };
    if let Some(poses) = &poses {
        check_count(&pose_file, "poses", poses.len(), files.len(), &images)?;
    }
    let times_file = folder.join("times.txt");
    let times = if times_file.exists() { Some(read_times(&times_file)?) } else { None };
    if let Some(times) = &times {
        check_count(&times_file, "times", times.len(), files.len(), &images)?;
    }
    let depth = vec![None; files.len()];
    Ok(FileSequence { name: last_part(folder), files, intrinsics, poses, times, depth })
}

/// A camera that looks at 53 degrees of width, for frames that come without one.
fn stand_in(width: usize, height: usize) -> Intrinsics {
    let (columns, rows) = (width as f64, height as f64);
    let camera = Intrinsics::new(columns, columns, 0.5 * (columns - 1.0), 0.5 * (rows - 1.0), width, height);
    camera.expect("sides of pictures are positive")
}

/// **Errors** when two files differ in their extension only: what is written for a frame goes by its name without it.
fn check_names(files: &[PathBuf]) -> Result<(), DataError> {
    let mut seen = HashMap::new();
    for file in files {
        if let Some(other) = seen.insert(file.file_stem(), file) {
            let reason = format!("the same frame name as {}", last_part(other));
            return Err(DataError::malformed(file, reason, "rename or remove one of the two"));
        }
    }
    Ok(())
}

fn intrinsics_path(root: &Path, folder: &Path) -> Result<PathBuf, DataError> {
    let candidates = [folder, root].into_iter().flat_map(|place| ["intrinsics.txt", "intrinsics.toml"].map(|f| place.join(f)));
    candidates.into_iter().find(|path| path.is_file()).ok_or_else(|| DataError::Missing {
        path: folder.to_owned(),
        what: "intrinsics.txt (or intrinsics.toml)".to_owned(),
        advice: EXAMPLE.to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::{Dataset, Image, write_rgb_png};
    use std::fs;

    const CAMERA: &str = "fu = 40\nfv = 41\nu0 = 23.5\nv0 = 11.5\nwidth = 48\nheight = 24\n";

    fn put_frames(folder: &Path, count: usize) {
        fs::create_dir_all(folder).unwrap();
        for i in 0..count {
            let image = Image::from_vec(3, 12, 24, vec![i as f32 / 51.0; 864]);
            write_rgb_png(&folder.join(format!("{:02}.png", 10 * i)), &image).unwrap();
        }
    }

    fn layout() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        put_frames(folder.path(), 4);
        fs::write(folder.path().join("intrinsics.txt"), CAMERA).unwrap();
        folder
    }

    fn message(folder: &tempfile::TempDir) -> String {
        open_folder(folder.path(), &LoadOptions::default()).err().expect("must be refused").to_string()
    }

    #[test]
    fn frames_without_a_camera_are_opened_where_none_is_needed() {
        let folder = tempfile::tempdir().unwrap();
        put_frames(folder.path(), 3);
        assert!(open_folder(folder.path(), &LoadOptions::default()).is_err());
        let options = LoadOptions { needs_camera: false, ..LoadOptions::default() };
        let camera = open_folder(folder.path(), &options).unwrap().frame(0, 0).unwrap().intrinsics;
        assert_eq!([camera.fu, camera.fv, camera.u0, camera.v0], [24.0, 24.0, 11.5, 5.5]);
        fs::write(folder.path().join("intrinsics.txt"), CAMERA).unwrap();
        assert_eq!(
            open_folder(folder.path(), &options).unwrap().frame(0, 0).unwrap().intrinsics.fu,
            20.0,
            "one that is there counts"
        );
        fs::write(folder.path().join("intrinsics.txt"), "0 0 0 0").unwrap();
        assert!(open_folder(folder.path(), &options).is_err(), "and its faults are told");
    }

    #[test]
    fn frames_come_in_the_order_of_their_names_with_scaled_intrinsics() {
        let folder = layout();
        fs::write(folder.path().join("poses.txt"), "1 0 0 0 0 1 0 0 0 0 1 2\n".repeat(4)).unwrap();
        fs::write(folder.path().join("notes.md"), "not a frame").unwrap();
        let data = open_folder(folder.path(), &LoadOptions::default()).unwrap();
        assert_eq!((data.sequence_count(), data.sequence_len(0)), (1, 4));
        let frame = data.frame(0, 2).unwrap();
        assert_eq!(frame.name, "20");
        assert!((frame.image.data[0] - 2.0 / 51.0).abs() < 1e-6);
        assert_eq!((frame.intrinsics.fu, frame.intrinsics.u0, frame.intrinsics.width), (20.0, 11.5, 24));
        assert_eq!(frame.world_from_camera.unwrap().translation.z, 2.0);
        assert!(data.pair_truth(0, 1, 2).unwrap().is_none());
    }

    #[test]
    fn numbers_in_names_count_as_numbers() {
        let folder = tempfile::tempdir().unwrap();
        let image = Image::from_vec(3, 12, 24, vec![0.0; 864]);
        let names = ["clip1_9", "clip1_10", "clip1_011", "clip2_0", "clip10_0", "clip10_a"];
        for name in names {
            write_rgb_png(&folder.path().join(format!("{name}.png")), &image).unwrap();
        }
        fs::write(folder.path().join("intrinsics.txt"), CAMERA).unwrap();
        let data = open_folder(folder.path(), &LoadOptions::default()).unwrap();
        let read: Vec<_> = (0..names.len()).map(|k| data.frame(0, k).unwrap().name.clone()).collect();
        assert_eq!(read, names);
    }

    #[test]
    fn a_folder_of_sequences_shares_the_intrinsics() {
        let folder = tempfile::tempdir().unwrap();
        put_frames(&folder.path().join("b/images"), 3);
        put_frames(&folder.path().join("a"), 4);
        fs::create_dir(folder.path().join("empty")).unwrap();
        fs::write(folder.path().join("intrinsics.toml"), CAMERA).unwrap();
        let data = open_folder(folder.path(), &LoadOptions::default()).unwrap();
        assert_eq!((data.sequence_name(0), data.sequence_name(1), data.sequence_len(1)), ("a".into(), "b".into(), 3));
        let one = LoadOptions { sequences: vec!["b".into()], ..LoadOptions::default() };
        assert_eq!(open_folder(folder.path(), &one).unwrap().sequence_count(), 1);
        let none = LoadOptions { sequences: vec!["c".into()], ..LoadOptions::default() };
        let refused = open_folder(folder.path(), &none).err().unwrap().to_string();
        assert!(refused.contains("sequence c with frames not found; choose among a, b"), "{refused}");
    }

    #[test]
    fn missing_intrinsics_show_an_example() {
        let folder = layout();
        fs::remove_file(folder.path().join("intrinsics.txt")).unwrap();
        let message = message(&folder);
        assert!(message.contains("intrinsics.txt (or intrinsics.toml) not found; write fu fv u0 v0"), "{message}");
        assert!(message.contains("718.856 718.856 607.193 185.216"), "{message}");
    }

    #[test]
    fn faults_are_named() {
        let folder = layout();
        fs::write(folder.path().join("intrinsics.txt"), CAMERA.replace("24", "30")).unwrap();
        assert!(message(&folder).contains("intrinsics belong to 48x30, but the frames are 24x12"));
        fs::write(folder.path().join("intrinsics.txt"), CAMERA.replace("40", "-40")).unwrap();
        assert!(message(&folder).contains("intrinsics.txt: focal length fu = -40"));
        fs::write(folder.path().join("intrinsics.txt"), CAMERA).unwrap();
        fs::write(folder.path().join("poses.txt"), "1 0 0 0 0 1 0 0 0 0 1 2\n").unwrap();
        assert!(message(&folder).contains("poses.txt: 1 poses, but 4 frames in"));
        fs::write(folder.path().join("poses.txt"), "1 0 0 0 0 1 0 0 0 0 2 2\n").unwrap();
        assert!(message(&folder).contains("poses.txt:1: R^T R deviates from I by 3.0e0"));
    }

    #[test]
    fn two_frames_of_one_name_are_refused() {
        let folder = layout();
        fs::copy(folder.path().join("10.png"), folder.path().join("10.JPG")).unwrap();
        let message = message(&folder);
        assert!(message.contains("10.png: the same frame name as 10.JPG; rename or remove one"), "{message}");
    }

    #[test]
    fn frames_that_do_not_make_a_sequence_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        assert!(message(&folder).contains("a frame (PNG or JPEG) not found"));
        put_frames(folder.path(), 1);
        assert!(message(&folder).contains("1 frame(s) found, but training needs at least three frames"));
        put_frames(folder.path(), 3);
        write_rgb_png(&folder.path().join("99.png"), &Image::zeros(3, 3, 3)).unwrap();
        assert!(message(&folder).contains("99.png: size 3x3, but"));
        fs::write(folder.path().join("99.png"), b"").unwrap();
        assert!(message(&folder).contains("99.png: truncated image (the file is empty)"));
    }
}
