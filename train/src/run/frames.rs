//! Datasets by configuration.

use std::path::Path;

use anyhow::Result;
use dimode_autodiff::par;

use crate::config::{Config, DataConfig};
use crate::data::synthetic::{Split, SyntheticConfig, SyntheticDataset};
use crate::data::{DataError, Dataset, Frame, LoadOptions, open};

/// At most this many frames are decoded or rendered before a run begins.
const CHECKED_FRAMES: usize = 400;
/// Frames of a snippet.
const SNIPPET: usize = 3;

/// How frames of a folder are loaded for networks of this configuration.
pub fn load_options(data: &DataConfig) -> LoadOptions {
    LoadOptions {
        sequences: data.sequences.clone(),
        camera: data.camera,
        size: Some((data.width, data.height)),
        center_crop: data.center_crop,
        ..LoadOptions::default()
    }
}

/// The frames of a folder at the size of the networks; every sequence has at least `min_frames`.
///
/// **Errors** [`DataError`] as [`open`].
pub fn open_frames(path: &Path, data: &DataConfig, min_frames: usize) -> Result<Box<dyn Dataset>, DataError> {
    open(path, &LoadOptions { min_frames, ..load_options(data) })
}

/// The frames that a configuration trains on: its folder, or the training worlds of its seed.
///
/// **Errors** [`DataError`].
pub fn training_frames(config: &Config) -> Result<Box<dyn Dataset>, DataError> {
    match &config.data.path {
        Some(path) => open_frames(path, &config.data, SNIPPET),
        None => Ok(Box::new(worlds(config, Split::Train, config.data.worlds, config.data.frames)?)),
    }
}

/// Worlds of the same kind that were not trained on, for evaluation.
///
/// **Errors** [`DataError::Option`].
pub fn held_out_worlds(config: &Config) -> Result<SyntheticDataset, DataError> {
    worlds(config, Split::HeldOut, config.eval.worlds, config.eval.frames)
}

/// Frames of a sequence that are loaded at a time.
const CHUNK: usize = 16;

/// Shows the frames of a sequence in order, with a few in memory at a time.
///
/// **Errors** when a frame cannot be read, and those of `visit`.
pub(super) fn for_each_frame(dataset: &dyn Dataset, sequence: usize, visit: &mut dyn FnMut(&Frame) -> Result<()>) -> Result<()> {
    let len = dataset.sequence_len(sequence);
    for start in (0..len).step_by(CHUNK) {
        let frames = par::map_indices(CHUNK.min(len - start), |k| dataset.frame(sequence, start + k));
        for frame in frames {
            visit(&*frame?)?;
        }
    }
    Ok(())
}

/// The frames on which a run is scored: those of `data`, or of the folder that it was trained on, or worlds that it was not
/// trained on. `sequences` chooses among those of a folder; empty for all of `data`, or for those of the run.
///
/// **Errors** [`DataError`], and [`DataError::Option`] for `sequences` of worlds, which cannot be chosen.
pub(super) fn frames_to_score(config: &Config, data: Option<&Path>, sequences: &[String]) -> Result<Box<dyn Dataset>, DataError> {
    let mut settings = config.data.clone();
    match data.or(settings.path.clone().as_deref()) {
        Some(path) => {
            if data.is_some() || !sequences.is_empty() {
                settings.sequences = sequences.to_vec();
            }
            open_frames(path, &settings, 1)
        }
        None if sequences.is_empty() => Ok(Box::new(held_out_worlds(config)?)),
        None => {
            let reason = "the run is scored on embedded worlds; name a folder with --data, or leave --sequences out".to_owned();
            Err(DataError::Option { option: "sequences", value: format!("{sequences:?}"), reason })
        }
    }
}

fn worlds(config: &Config, split: Split, sequences: usize, frames: usize) -> Result<SyntheticDataset, DataError> {
    let data = &config.data;
    SyntheticDataset::new(SyntheticConfig {
        preset: data.preset,
        width: data.width,
        height: data.height,
        seed: config.seed,
        split,
        sequences,
        frames,
        noise: data.noise,
        exposure: data.exposure,
        night: data.night,
        moving_object: data.moving_object,
    })
}

/// [`training_frames`], when it is known that a run can use them: the frames of a small folder can be decoded; worlds can be
/// rendered, and show depth that is scored.
///
/// **Errors** [`DataError`] for the first thing that cannot be used.
pub fn checked_frames(config: &Config) -> Result<Box<dyn Dataset>, DataError> {
    let dataset = training_frames(config)?;
    if config.data.path.is_none() {
        check_scored_depth(config)?;
    } else if frame_count(dataset.as_ref()) <= CHECKED_FRAMES {
        for (sequence, frame) in all_frames(dataset.as_ref()) {
            dataset.frame(sequence, frame)?;
        }
    }
    Ok(dataset)
}

/// Renders held-out frames up to the first that shows depth within the bounds of the evaluation.
fn check_scored_depth(config: &Config) -> Result<(), DataError> {
    let (worlds, protocol) = (held_out_worlds(config)?, config.eval.protocol());
    for (sequence, frame) in all_frames(&worlds).take(CHECKED_FRAMES) {
        let frame = worlds.frame(sequence, frame)?;
        if frame.depth.iter().any(|depth| depth.data.iter().any(|&z| protocol.counts(z))) {
            return Ok(());
        }
    }
    if frame_count(&worlds) > CHECKED_FRAMES {
        return Ok(());
    }
    let reason = format!("the worlds show nothing between it and eval.max_depth = {}; widen the range", protocol.max_depth);
    Err(DataError::Option { option: "eval.min_depth", value: protocol.min_depth.to_string(), reason })
}

fn frame_count(dataset: &dyn Dataset) -> usize {
    (0..dataset.sequence_count()).map(|s| dataset.sequence_len(s)).sum()
}

/// Sequence and number of every frame, in order.
fn all_frames(dataset: &dyn Dataset) -> impl Iterator<Item = (usize, usize)> {
    (0..dataset.sequence_count()).flat_map(|s| (0..dataset.sequence_len(s)).map(move |f| (s, f)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::{Image, write_rgb_png};
    use std::fs;

    #[test]
    fn camera_and_crop_of_the_settings_choose_the_frames() {
        let folder = tempfile::tempdir().unwrap();
        let sequence = folder.path().join("sequences/00");
        for (camera, level) in [("image_0", 0.2), ("image_2", 0.8)] {
            fs::create_dir_all(sequence.join(camera)).unwrap();
            for i in 0..3 {
                let image = Image::from_fn(3, 64, 256, |_, _, _| level);
                write_rgb_png(&sequence.join(camera).join(format!("{i:06}.png")), &image).unwrap();
            }
        }
        let calib = "P0: 90 0 127.5 0 0 90 31.5 0 0 0 1 0\nP2: 91 0 127.5 0 0 91 31.5 0 0 0 1 0\n";
        fs::write(sequence.join("calib.txt"), calib).unwrap();
        let frame = |settings: &str| {
            let config =
                Config::from_toml(&format!("[data]\nwidth = 128\nheight = 64\n{settings}"), Path::new("run.toml")).unwrap();
            open_frames(folder.path(), &config.data, SNIPPET).unwrap().frame(0, 1).unwrap()
        };
        let plain = frame("");
        assert_eq!((plain.intrinsics.fu, plain.intrinsics.fv), (45.5, 91.0), "left colour, squeezed");
        let cropped = frame("camera = \"left-grey\"\ncenter_crop = true\n");
        assert_eq!((cropped.intrinsics.fu, cropped.intrinsics.fv), (90.0, 90.0), "left grey, cropped");
        assert!(plain.image.data[0] > 0.7 && cropped.image.data[0] < 0.3);
    }

    #[test]
    fn bounds_that_nothing_rendered_meets_are_refused() {
        let mut config = Config::quick();
        (config.data.width, config.data.height) = (64, 64);
        checked_frames(&config).unwrap();
        (config.eval.min_depth, config.eval.max_depth) = (50_000.0, 60_000.0);
        let message = checked_frames(&config).err().unwrap().to_string();
        assert!(message.starts_with("eval.min_depth = 50000: the worlds show nothing"), "{message}");
    }

    #[test]
    fn settings_that_the_renderer_refuses_are_refused_before_a_run() {
        for change in [|c: &mut Config| c.data.frames = 6000, |c: &mut Config| c.eval.frames = 6000] {
            let mut config = Config::quick();
            change(&mut config);
            let message = checked_frames(&config).err().unwrap().to_string();
            assert!(message.starts_with("frames = 6000"), "{message}");
        }
    }
}
