//! Sequences whose frames are image files: what the layouts on disk have in common.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use dimode_geometry::{Intrinsics, Se3};

use super::cache::FrameCache;
use super::decode::{image_size, read_image};
use super::image_io::read_depth_png;
use super::{DataError, Dataset, Frame, LoadOptions, Map, PairTruth, View};

/// One sequence of image files, checked.
#[derive(Clone, Debug)]
pub(crate) struct FileSequence {
    /// What messages call it.
    pub name: String,
    /// The images in time order, all of the size of `intrinsics`.
    pub files: Vec<PathBuf>,
    /// The camera in pixels of the stored images.
    pub intrinsics: Intrinsics,
    /// World from camera of each frame.
    pub poses: Option<Vec<Se3>>,
    /// The time of each frame in seconds.
    pub times: Option<Vec<f64>>,
    /// Depth file of each frame.
    pub depth: Vec<Option<PathBuf>>,
}

/// A dataset of image files; see [`super::open`].
pub struct FileDataset {
    name: String,
    sequences: Vec<FileSequence>,
    size: Option<(usize, usize)>,
    center_crop: bool,
    cache: FrameCache,
}

impl FileDataset {
    pub(crate) fn new(name: String, sequences: Vec<FileSequence>, options: &LoadOptions) -> Self {
        let cache = FrameCache::new(options.cache_bytes);
        Self { name, sequences, size: options.size, center_crop: options.center_crop, cache }
    }

    fn check_index(&self, sequence: usize, frame: usize) -> Result<&FileSequence, DataError> {
        let range = |dataset: &str, what, index, len| DataError::OutOfRange { dataset: dataset.to_owned(), what, index, len };
        let Some(found) = self.sequences.get(sequence) else {
            return Err(range(&self.name, "sequence", sequence, self.sequences.len()));
        };
        if frame >= found.files.len() {
            return Err(range(&found.name, "frame", frame, found.files.len()));
        }
        Ok(found)
    }

    fn load(&self, sequence: &FileSequence, frame: usize) -> Result<Frame, DataError> {
        let path = &sequence.files[frame];
        let image = read_image(path)?;
        let camera = &sequence.intrinsics;
        if (image.width, image.height) != (camera.width, camera.height) {
            let reason = format!(
                "size {}x{}, it was {}x{} when the folder was opened",
                image.width, image.height, camera.width, camera.height
            );
            return Err(DataError::malformed(path, reason, "do not change files while they are in use"));
        }
        let depth = match &sequence.depth[frame] {
            Some(file) => Some(depth_of_size(file, camera)?),
            None => None,
        };
        let view = self.prepare(View::new(image, *camera, depth));
        let name = stem(path);
        let world_from_camera = sequence.poses.as_ref().map(|poses| poses[frame]);
        Ok(Frame { image: view.image, intrinsics: view.intrinsics, depth: view.depth, world_from_camera, name })
    }

    fn prepare(&self, view: View) -> View {
        match self.size {
            Some((width, height)) if self.center_crop => view.center_crop_to_shape(width, height).resize(width, height),
            Some((width, height)) => view.resize(width, height),
            None => view,
        }
    }
}

impl Dataset for FileDataset {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn sequence_count(&self) -> usize {
        self.sequences.len()
    }

    fn sequence_name(&self, sequence: usize) -> String {
        self.sequences[sequence].name.clone()
    }

    fn sequence_len(&self, sequence: usize) -> usize {
        self.sequences[sequence].files.len()
    }

    fn frame_name(&self, sequence: usize, frame: usize) -> String {
        stem(&self.sequences[sequence].files[frame])
    }

    fn frame(&self, sequence: usize, frame: usize) -> Result<Arc<Frame>, DataError> {
        let found = self.check_index(sequence, frame)?;
        if let Some(cached) = self.cache.get((sequence, frame)) {
            return Ok(cached);
        }
        let loaded = Arc::new(self.load(found, frame)?);
        self.cache.insert((sequence, frame), &loaded);
        Ok(loaded)
    }

    fn pair_truth(&self, sequence: usize, target_frame: usize, source_frame: usize) -> Result<Option<PairTruth>, DataError> {
        self.check_index(sequence, target_frame)?;
        self.check_index(sequence, source_frame)?;
        Ok(None)
    }

    fn times(&self, sequence: usize) -> Option<&[f64]> {
        self.sequences[sequence].times.as_deref()
    }
}

/// The name of a file without its ending.
fn stem(path: &Path) -> String {
    path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default()
}

fn depth_of_size(path: &Path, camera: &Intrinsics) -> Result<Map, DataError> {
    let map = read_depth_png(path)?;
    if (map.width, map.height) == (camera.width, camera.height) {
        return Ok(map);
    }
    let reason = format!("depth {}x{}, image {}x{}", map.width, map.height, camera.width, camera.height);
    Err(DataError::malformed(path, reason, "store depth at the size of the image"))
}

/// The entries of a folder whose names do not start with a dot, sorted by name; runs of digits in names count as numbers, so that
/// `frame2` comes before `frame10`.
pub(crate) fn sorted_entries(folder: &Path, what: &str) -> Result<Vec<PathBuf>, DataError> {
    let failed = |error| DataError::read(folder, what, error);
    let mut entries = Vec::new();
    for entry in fs::read_dir(folder).map_err(failed)? {
        let entry = entry.map_err(failed)?;
        if !entry.file_name().to_string_lossy().starts_with('.') {
            entries.push(entry.path());
        }
    }
    entries.sort_by_cached_key(|path| (name_key(&last_part(path)), path.clone()));
    Ok(entries)
}

/// A name as text and numbers in turn; a number is its digits without leading zeros, shorter ones first.
fn name_key(name: &str) -> Vec<(String, usize, String)> {
    let mut parts = Vec::new();
    let mut rest = name;
    while !rest.is_empty() {
        let (text, after) = rest.split_at(rest.find(|c: char| c.is_ascii_digit()).unwrap_or(rest.len()));
        let (digits, after) = after.split_at(after.find(|c: char| !c.is_ascii_digit()).unwrap_or(after.len()));
        let number = digits.trim_start_matches('0');
        parts.push((text.to_owned(), number.len(), number.to_owned()));
        rest = after;
    }
    parts
}

/// The PNG and JPEG files of a folder by extension (any case), in the order of [`sorted_entries`].
pub(crate) fn image_files(folder: &Path) -> Result<Vec<PathBuf>, DataError> {
    let is_image = |path: &PathBuf| {
        let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase());
        matches!(extension.as_deref(), Some("png" | "jpg" | "jpeg")) && path.is_file()
    };
    Ok(sorted_entries(folder, "folder of frames")?.into_iter().filter(is_image).collect())
}

/// The folders of the sequences with the `wanted` names, in that order, or all of them without a wish. `is_meant` tells whether the
/// name of a folder is the wanted one.
///
/// **Errors** [`DataError::Option`] for an empty name and for a sequence that is named twice, [`DataError::Missing`] for one that
/// `parent` does not hold.
pub(crate) fn choose(
    parent: &Path,
    all: Vec<PathBuf>,
    wanted: &[String],
    is_meant: impl Fn(&str, &str) -> bool,
) -> Result<Vec<PathBuf>, DataError> {
    if wanted.is_empty() {
        return Ok(all);
    }
    let refuse = |reason: String| DataError::Option { option: "sequences", value: format!("{wanted:?}"), reason };
    let mut chosen: Vec<PathBuf> = Vec::new();
    for name in wanted {
        if name.is_empty() {
            return Err(refuse("a name is empty; name every sequence, or none to take all".to_owned()));
        }
        let Some(found) = all.iter().find(|path| is_meant(&last_part(path), name)) else {
            let names: Vec<String> = all.iter().map(|path| last_part(path)).collect();
            return Err(DataError::Missing {
                path: parent.join(name),
                what: format!("sequence {name} with frames"),
                advice: format!("choose among {}", names.join(", ")),
            });
        };
        if chosen.contains(found) {
            return Err(refuse(format!("sequence {} is named twice; name it once", last_part(found))));
        }
        chosen.push(found.clone());
    }
    Ok(chosen)
}

/// The common (width, height) of the files of a sequence.
///
/// **Errors** fewer than `needed` files (or none), a file that is no complete image, two sizes (both files are named).
pub(crate) fn common_size(folder: &Path, files: &[PathBuf], needed: usize) -> Result<(usize, usize), DataError> {
    let needed = needed.max(1);
    if files.len() < needed {
        return Err(DataError::TooFewFrames { path: folder.to_owned(), found: files.len(), needed });
    }
    let first = image_size(&files[0])?;
    for file in &files[1..] {
        let size = image_size(file)?;
        if size != first {
            return Err(DataError::SizeMismatch { path: file.clone(), size, other_path: files[0].clone(), other_size: first });
        }
    }
    Ok(first)
}

/// **Errors** [`DataError::CountMismatch`] unless `found` entries of `path` meet as many frames in `folder`.
pub(crate) fn check_count(
    path: &Path,
    what: &'static str,
    found: usize,
    expected: usize,
    folder: &Path,
) -> Result<(), DataError> {
    if found == expected {
        return Ok(());
    }
    let advice = format!("give one row a frame, or remove the file to go without {what}");
    let (path, frames) = (path.to_owned(), folder.to_owned());
    Err(DataError::CountMismatch { path, what, found, expected, frames, advice })
}

/// The last part of a path as text, for names.
pub(crate) fn last_part(path: &Path) -> String {
    let part = path.file_name().or_else(|| path.components().next_back().map(|c| c.as_os_str()));
    part.map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}
