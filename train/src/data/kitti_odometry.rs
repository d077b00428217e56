//! The KITTI odometry layout.
//!
//! ```text
//! ROOT/sequences/NN/image_0|image_2/%06d.png   frames (PNG or JPEG)
//! ROOT/sequences/NN/calib.txt                  the row of the camera that is used: P0 for image_0, P2 for image_2
//! ROOT/sequences/NN/times.txt                  optional, seconds, one a line
//! ROOT/poses/NN.txt                            optional, world from camera, twelve numbers a line
//! ROOT/depth/NN/%06d.png                       optional, 16-bit, metres * 256
//! ```

use std::path::{Path, PathBuf};

use super::DataError;
use super::calib::Calibration;
use super::file_dataset::{FileDataset, FileSequence, check_count, choose, common_size, image_files, last_part, sorted_entries};
use super::options::{KittiCamera, LoadOptions};
use super::poses::read_poses;
use super::times::read_times;

/// Opens a folder of the KITTI odometry layout and checks all of it but the pixels.
///
/// **Errors** name the file: no `sequences` folder, no sequence in it, an asked-for sequence or camera that is not there,
/// fewer frames than asked for, gaps in the numbering, frames of different sizes, truncated files, faults of the calibration,
/// the times and the poses, counts that differ from the number of frames.
pub fn open_kitti_odometry(root: &Path, options: &LoadOptions) -> Result<FileDataset, DataError> {
    options.check()?;
    let folders = sequence_folders(root, options)?;
    let sequences = folders.iter().map(|folder| open_sequence(root, folder, options)).collect::<Result<Vec<_>, _>>()?;
    Ok(FileDataset::new(last_part(root), sequences, options))
}

/// The folders of the wanted sequences, or all that have images; `6` finds `06`.
fn sequence_folders(root: &Path, options: &LoadOptions) -> Result<Vec<PathBuf>, DataError> {
    let parent = root.join("sequences");
    let all: Vec<PathBuf> = sorted_entries(&parent, "`sequences` folder")?
        .into_iter()
        .filter(|path| find_camera(path, options.camera).is_some())
        .collect();
    if all.is_empty() {
        let what = options.camera.map_or("image_2 or image_0".to_owned(), KittiCamera::folder);
        let advice = match options.camera {
            Some(camera) => format!("choose a data.camera that is there, or put its frames in sequences/NN/{}", camera.folder()),
            None => "frames belong in sequences/NN/image_2/000000.png and so on".to_owned(),
        };
        return Err(DataError::Missing { path: parent, what: format!("a sequence with frames in {what}"), advice });
    }
    choose(&parent, all, &options.sequences, |folder, name| folder == name || folder == format!("{name:0>2}"))
}

/// The wanted camera if it is there; without a wish left colour, then left grey.
fn find_camera(folder: &Path, wanted: Option<KittiCamera>) -> Option<KittiCamera> {
    let wishes = wanted.map_or(vec![KittiCamera::LeftColour, KittiCamera::LeftGrey], |camera| vec![camera]);
    wishes.into_iter().find(|camera| folder.join(camera.folder()).is_dir())
}

fn open_sequence(root: &Path, folder: &Path, options: &LoadOptions) -> Result<FileSequence, DataError> {
    let camera = find_camera(folder, options.camera).unwrap_or(KittiCamera::LeftGrey);
    let name = last_part(folder);
    let images = folder.join(camera.folder());
    let files = image_files(&images)?;
    let (width, height) = common_size(&images, &files, options.min_frames)?;
    check_numbering(&files)?;
    let intrinsics = Calibration::read(&folder.join("calib.txt"))?.camera(&camera.label(), width, height)?;
    let times_file = folder.join("times.txt");
    let times = if times_file.exists() { Some(read_times(&times_file)?) } else { None };
    if let Some(times) = &times {
        check_count(&times_file, "times", times.len(), files.len(), &images)?;
    }
    let pose_file = root.join("poses").join(format!("{name}.txt"));
    let poses = if camera.has_truth() && pose_file.exists() { Some(read_poses(&pose_file)?) } else { None };
    if let Some(poses) = &poses {
        check_count(&pose_file, "poses", poses.len(), files.len(), &images)?;
    }
    let true_depth = |file: &PathBuf| camera.has_truth().then(|| depth_file(&root.join("depth").join(&name), file)).flatten();
    let depth = files.iter().map(true_depth).collect();
    Ok(FileSequence { name, files, intrinsics, poses, times, depth })
}

fn depth_file(folder: &Path, image: &Path) -> Option<PathBuf> {
    let path = folder.join(image.file_name()?).with_extension("png");
    path.is_file().then_some(path)
}

/// **Errors** unless the file names are numbers that follow each other without a gap.
fn check_numbering(files: &[PathBuf]) -> Result<(), DataError> {
    let mut previous: Option<u64> = None;
    for file in files {
        let stem = file.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
        let number: u64 = stem.parse().map_err(|_| {
            DataError::malformed(file, format!("bad frame number {stem:?}"), "name frames 000000.png, 000001.png and so on")
        })?;
        if let Some(before) = previous
            && before.checked_add(1) != Some(number)
        {
            let reason = format!("frame {number} follows frame {before}, frames between them are missing or out of order");
            return Err(DataError::malformed(file, reason, "supply the missing frames or renumber them"));
        }
        previous = Some(number);
    }
    Ok(())
}

#[cfg(test)]
mod tests;
