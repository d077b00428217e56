//! Pseudo-depth that does not come from the network that learns: rendered and degraded, or read from a folder.

use std::path::{Path, PathBuf};

use dimode_autodiff::{Shape, Tensor, rng};

use crate::config::{Config, DegradationConfig, PseudoDepth};
use crate::data::{DataError, Dataset, Frame, Map, crop_map_to_shape, read_depth_png};
use crate::losses::pseudo_depth::{Degradation, degraded, external};

/// What to do about a map that is missing.
const ADVICE: &str = "every frame but the first and last of a sequence needs one, there or in a folder `depth` beside it, as \
                      `dimode infer` writes them";

/// Who says the pseudo-depth of a batch. A frame has the same one whenever it is asked for.
#[derive(Clone, Debug, PartialEq)]
pub enum Teacher {
    /// Nobody: the losses ask for none, or the network itself says it.
    None,
    /// The embedded world.
    Rendered {
        /// What is done to the true depth; its seed is that of the run.
        degradation: Degradation,
    },
    /// Files.
    Folder {
        /// Where they are.
        path: PathBuf,
        /// Whether their centre is cut to the shape of the frames.
        center_crop: bool,
    },
}

impl Teacher {
    /// The one that a configuration names, if a stage asks for it.
    pub fn new(config: &Config) -> Self {
        let settings = &config.loss.local_structure;
        if config.train.stages.iter().all(|stage| stage.lambda3 == 0.0) {
            return Self::None;
        }
        let DegradationConfig { scale, noise, wavelength } = settings.degradation;
        match (settings.pseudo_depth, &settings.folder) {
            (PseudoDepth::Rendered, _) => {
                Self::Rendered { degradation: Degradation { scale, noise, wavelength, seed: config.seed } }
            }
            (PseudoDepth::Folder, Some(path)) => Self::Folder { path: path.clone(), center_crop: config.data.center_crop },
            _ => Self::None,
        }
    }

    /// Looks whether there is a map for every target of a dataset, without reading it.
    ///
    /// # Errors
    /// For the first that is missing.
    pub fn check(&self, dataset: &dyn Dataset) -> Result<(), DataError> {
        let Self::Folder { path, .. } = self else { return Ok(()) };
        for sequence in 0..dataset.sequence_count() {
            // The first and the last frame are nobody's target.
            for frame in 1..dataset.sequence_len(sequence).saturating_sub(1) {
                file(path, &dataset.sequence_name(sequence), &dataset.frame_name(sequence, frame))?;
            }
        }
        Ok(())
    }

    /// The pseudo-depth of a frame as it was taken, of its size.
    ///
    /// # Errors
    /// When a file is missing or cannot be read, or a pixel has no depth.
    pub fn map(
        &self,
        dataset: &dyn Dataset,
        (sequence, number): (usize, usize),
        frame: &Frame,
    ) -> Result<Option<Map>, DataError> {
        match self {
            Self::None => Ok(None),
            Self::Rendered { degradation } => {
                let depth = frame.depth.as_ref().expect("the embedded world knows the depth of its frames");
                let depth = without_holes(depth);
                let seed = rng::splitmix64(rng::splitmix64(degradation.seed, sequence as u64), number as u64);
                Ok(Some(plain(&degraded(&tensor(&depth), Degradation { seed, ..*degradation }))))
            }
            Self::Folder { path, center_crop } => {
                let file = file(path, &dataset.sequence_name(sequence), &frame.name)?;
                let map = read_depth_png(&file)?;
                let (height, width) = (frame.image.height, frame.image.width);
                let map = if *center_crop { crop_map_to_shape(&map, width, height) } else { map };
                let fitted = external(&tensor(&map), height, width);
                let advice = "give every pixel a depth above 0, in any unit";
                fitted.map(|map| Some(plain(&map))).map_err(|error| DataError::malformed(&file, error.to_string(), advice))
            }
        }
    }
}

/// The depth with twice the largest one where it is unknown: that is the sky.
fn without_holes(depth: &Map) -> Map {
    let far = 2.0 * depth.data.iter().copied().fold(0.0, f32::max);
    Map { data: depth.data.iter().map(|&z| if z > 0.0 { z } else { far }).collect(), ..*depth }
}

/// The map of a frame.
fn file(folder: &Path, sequence: &str, name: &str) -> Result<PathBuf, DataError> {
    let name = format!("{name}.png");
    let places = [folder.join(sequence).join(&name), folder.join(sequence).join("depth").join(&name)];
    places.iter().find(|place| place.is_file()).cloned().ok_or_else(|| DataError::Missing {
        path: places[0].clone(),
        what: "pseudo-depth map".to_owned(),
        advice: ADVICE.to_owned(),
    })
}

fn tensor(map: &Map) -> Tensor<f32> {
    Tensor::from_vec(Shape::new(1, 1, map.height, map.width), map.data.clone())
}

fn plain(map: &Tensor<f32>) -> Map {
    Map::from_vec(map.shape().h(), map.shape().w(), map.data().to_vec())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::batch::Batch;
    use crate::config::LossPreset;
    use crate::data::write_depth_png;
    use crate::mirror::mirrored;
    use crate::run::training_frames;

    fn config(pseudo_depth: PseudoDepth) -> Config {
        let mut config = LossPreset::Dimode.config();
        (config.data.width, config.data.height, config.data.worlds, config.data.frames) = (64, 64, 2, 3);
        config.loss.local_structure.pseudo_depth = pseudo_depth;
        config
    }

    #[test]
    fn nobody_is_asked_where_nothing_needs_it() {
        let mut rendered = config(PseudoDepth::Rendered);
        assert!(matches!(Teacher::new(&rendered), Teacher::Rendered { .. }));
        rendered.train.stages.iter_mut().for_each(|stage| stage.lambda3 = 0.0);
        assert_eq!(Teacher::new(&rendered), Teacher::None);
        for own in [PseudoDepth::None, PseudoDepth::SelfGuided] {
            assert_eq!(Teacher::new(&config(own)), Teacher::None);
        }
    }

    #[test]
    fn a_frame_has_one_pseudo_depth_mirrored_with_it() {
        let config = config(PseudoDepth::Rendered);
        let (frames, teacher) = (training_frames(&config).unwrap(), Teacher::new(&config));
        let frame = frames.frame(1, 1).unwrap();
        let map = teacher.map(frames.as_ref(), (1, 1), &frame).unwrap().unwrap();
        assert_eq!(Some(&map), teacher.map(frames.as_ref(), (1, 1), &frame).unwrap().as_ref());
        let truth = without_holes(frame.depth.as_ref().unwrap());
        assert!(frame.depth.as_ref().unwrap().data.contains(&0.0), "no sky to be filled");
        let ratio = |i: usize| f64::from(map.data[i] / truth.data[i]).ln();
        let (least, most) = (0..map.data.len()).map(ratio).fold((f64::MAX, f64::MIN), |(a, b), x| (a.min(x), b.max(x)));
        assert!(least > -0.8 && most < 0.8 && most - least > 0.01 && most - least <= 0.1 + 1e-5, "{least} {most}");
        let mut seen = [false; 2];
        for step in 0..12 {
            let batch = Batch::load(
                frames.as_ref(),
                &[(0, 1), (1, 1)],
                (&config.train, &teacher),
                3,
                step,
                &dimode_autodiff::Pool::new(),
            )
            .unwrap();
            let found = batch.pseudo_depth.unwrap();
            let expected = if batch.flipped[1] { mirrored(&tensor(&map)) } else { tensor(&map) };
            assert_eq!(found.plane(1, 0), expected.data());
            seen[usize::from(batch.flipped[1])] = true;
        }
        assert_eq!(seen, [true; 2]);
    }

    #[test]
    fn maps_of_a_folder_are_found_in_both_places_and_resized() {
        let place = tempfile::tempdir().unwrap();
        let mut config = config(PseudoDepth::Folder);
        config.loss.local_structure.folder = Some(place.path().to_owned());
        let (frames, teacher) = (training_frames(&config).unwrap(), Teacher::new(&config));
        let map = Map::from_vec(32, 32, (0..1024).map(|i| 1.0 + (i % 32) as f32 / 8.0).collect());
        let frame = |number| frames.frame(0, number).unwrap();
        let load = |number| teacher.map(frames.as_ref(), (0, number), &frame(number)).map(|map| map.unwrap());
        std::fs::create_dir_all(place.path().join("00/depth")).unwrap();
        write_depth_png(&place.path().join("00/000001.png"), &map).unwrap();
        write_depth_png(&place.path().join("00/depth/000002.png"), &map).unwrap();
        let found = load(1).unwrap();
        assert_eq!((found.height, found.width), (64, 64));
        assert_eq!(found, load(2).unwrap());
        assert!((found.at(10, 20) - (1.0 + (20.5 / 2.0 - 0.5) / 8.0)).abs() < 1e-5, "{}", found.at(10, 20));
        let missing = teacher.check(frames.as_ref()).unwrap_err().to_string();
        assert!(missing.contains("01/000001.png: pseudo-depth map not found"), "{missing}");
        let message = load(0).unwrap_err().to_string();
        assert!(message.contains("00/000000.png: pseudo-depth map not found; every frame but the first and last"), "{message}");
        write_depth_png(&place.path().join("00/000000.png"), &Map::zeros(4, 4)).unwrap();
        let message = load(0).unwrap_err().to_string();
        assert!(message.contains("is 0 at row 0, column 0") && message.ends_with("above 0, in any unit"), "{message}");
    }
}
