//! Pseudo-depth that does not come from the network that learns: rendered and degraded, or read from a folder.

use std::path::{Path, PathBuf};

use dimode_autodiff::{Shape, Tensor, rng};

use crate::config::{Config, DegradationConfig, PseudoDepth};
use crate::data::{DataError, Dataset, Frame, Map, crop_map_to_shape, read_depth_png};
use crate::losses::pseudo_depth::{Degradation, degraded, external};

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

    /// The pseudo-depth of a frame as it was taken, of its size.
    ///
    /// # Errors
    /// When a file is missing or cannot be read, or a pixel has no depth.
    pub fn map(&self, dataset: &dyn Dataset, (sequence, number): (usize, usize), frame: &Frame) -> Result<Option<Map>, DataError> {
        match self {
            Self::None => Ok(None),
            Self::Rendered { degradation } => {
                let depth = frame.depth.as_ref().expect("the embedded world knows the depth of its frames");
                let seed = rng::splitmix64(rng::splitmix64(degradation.seed, sequence as u64), number as u64);
                Ok(Some(plain(&degraded(&tensor(depth), Degradation { seed, ..*degradation }))))
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

/// The map of a frame.
fn file(folder: &Path, sequence: &str, name: &str) -> Result<PathBuf, DataError> {
    let name = format!("{name}.png");
    let places = [folder.join(sequence).join(&name), folder.join(sequence).join("depth").join(&name)];
    places.iter().find(|place| place.is_file()).cloned().ok_or_else(|| DataError::Missing {
        path: places[0].clone(),
        what: "pseudo-depth map".to_owned(),
        advice: "every frame needs one, there or in a folder `depth` beside it, as `dimode infer` writes them".to_owned(),
    })
}

fn tensor(map: &Map) -> Tensor<f32> {
    Tensor::from_vec(Shape::new(1, 1, map.height, map.width), map.data.clone())
}

fn plain(map: &Tensor<f32>) -> Map {
    Map::from_vec(map.shape().h(), map.shape().w(), map.data().to_vec())
}
