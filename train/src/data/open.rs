//! One door to every layout on disk.

use std::path::Path;

use super::folder::{has_frames, open_folder};
use super::kitti_odometry::open_kitti_odometry;
use super::{DataError, Dataset, LoadOptions};

/// Opens the frames at `path`, whatever of the known layouts they have: a folder with `sequences` inside is taken as KITTI
/// odometry ([`open_kitti_odometry`]), any other one as a folder of frames with an intrinsics file ([`open_folder`]).
///
/// **Errors** nothing there, a file instead of a folder, neither layout (the message tells what was looked for), and all of
/// the two readers.
pub fn open(path: &Path, options: &LoadOptions) -> Result<Box<dyn Dataset>, DataError> {
    if !path.exists() {
        let advice = "check the path given as data folder".to_owned();
        return Err(DataError::Missing { path: path.to_owned(), what: "data folder".to_owned(), advice });
    }
    if !path.is_dir() {
        return Err(DataError::malformed(path, "a file, expected a folder of frames", "name the folder that holds it"));
    }
    if path.join("sequences").is_dir() {
        return Ok(Box::new(open_kitti_odometry(path, options)?));
    }
    if path.join("calib.txt").is_file() && (0..4).any(|n| path.join(format!("image_{n}")).is_dir()) {
        let advice = "name the folder that contains `sequences` and choose the sequence by its name";
        return Err(DataError::malformed(path, "a single sequence of the KITTI odometry layout", advice));
    }
    if has_frames(path)? {
        return Ok(Box::new(open_folder(path, options)?));
    }
    let reason = "no frames found; looked for the KITTI odometry layout (sequences/NN/image_2 or image_0 with calib.txt) and \
                  for PNG or JPEG frames with intrinsics.txt here, in `images`, and one folder below";
    Err(DataError::malformed(path, reason, "name a folder of one of these layouts"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::{Image, write_rgb_png};
    use std::fs;

    fn message(path: &Path) -> String {
        open(path, &LoadOptions::default()).err().expect("must be refused").to_string()
    }

    fn put_frames(folder: &Path) {
        fs::create_dir_all(folder).unwrap();
        for i in 0..3 {
            write_rgb_png(&folder.join(format!("{i:06}.png")), &Image::zeros(3, 8, 16)).unwrap();
        }
    }

    #[test]
    fn both_layouts_open() {
        let folder = tempfile::tempdir().unwrap();
        let sequence = folder.path().join("kitti/sequences/03");
        put_frames(&sequence.join("image_2"));
        fs::write(sequence.join("calib.txt"), "P2: 9 0 7.5 0 0 9 3.5 0 0 0 1 0\n").unwrap();
        let kitti = open(&folder.path().join("kitti"), &LoadOptions::default()).unwrap();
        assert_eq!((kitti.name(), kitti.sequence_name(0), kitti.sequence_len(0)), ("kitti".into(), "03".into(), 3));
        assert!(message(&sequence).contains("a single sequence of the KITTI odometry layout; name the folder"));
        put_frames(&folder.path().join("plain"));
        fs::write(folder.path().join("plain/intrinsics.txt"), "9 9 7.5 3.5").unwrap();
        let plain = open(&folder.path().join("plain"), &LoadOptions::default()).unwrap();
        assert_eq!((plain.name(), plain.sequence_len(0)), ("plain".into(), 3));
    }

    #[test]
    fn what_is_no_data_folder_is_explained() {
        let folder = tempfile::tempdir().unwrap();
        assert!(message(&folder.path().join("none")).contains("none: data folder not found; check the path"));
        assert!(message(folder.path()).contains("looked for the KITTI odometry layout"));
        let file = folder.path().join("a.png");
        write_rgb_png(&file, &Image::zeros(3, 8, 16)).unwrap();
        assert!(message(&file).contains("a.png: a file, expected a folder"));
    }
}
