//! Where frames come from: the embedded world or a folder.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::ConfigError;
use super::error::require;
use crate::data::KittiCamera;
use crate::data::synthetic::{MAX_FRAMES, Preset};

/// Where frames come from and what size they have.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DataConfig {
    /// Folder of real frames; none for the embedded world.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub path: Option<PathBuf>,
    /// Kind of the embedded world; not used with `path`.
    pub preset: Preset,
    /// Width of the frames that the networks see, in pixels.
    pub width: usize,
    /// Height of the frames that the networks see, in pixels.
    pub height: usize,
    /// Number of training worlds; they are rendered when needed, so many cost no more memory than few.
    pub worlds: usize,
    /// Frames rendered in each world.
    pub frames: usize,
    /// Standard deviation of photometric noise, in units of the full range 1.
    pub noise: f64,
    /// Strength of exposure changes from frame to frame (standard deviation of the logarithm of the gain), 0 to 1.
    pub exposure: f64,
    /// Render at night: dark, lit by the camera's own lights.
    pub night: bool,
    /// Add one object that moves by itself.
    pub moving_object: bool,
    /// Sequences of a folder to use, each named once; empty for all.
    pub sequences: Vec<String>,
    /// Camera of a folder in KITTI layout; none for left colour where it is there, else left grey.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera: Option<KittiCamera>,
    /// Cut the centre of a folder's frames to the shape of `width` x `height`, so that pixels keep their aspect, instead of
    /// squeezing the whole frame. Written when on: a run's settings without it say that frames are squeezed.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub center_crop: bool,
}

impl Default for DataConfig {
    fn default() -> Self {
        Self {
            path: None,
            preset: Preset::Street,
            width: 128,
            height: 64,
            worlds: 1024,
            frames: 5,
            noise: 0.0,
            exposure: 0.0,
            night: false,
            moving_object: false,
            sequences: Vec::new(),
            camera: None,
            center_crop: false,
        }
    }
}

impl DataConfig {
    /// **Errors** [`ConfigError::Value`] for the first value out of range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        if let Some(path) = &self.path {
            require(path.to_str().is_some(), "data.path", path.display(), "must be valid UTF-8: rename the folder")?;
        }
        side("data.width", self.width)?;
        side("data.height", self.height)?;
        require((1..=1 << 24).contains(&self.worlds), "data.worlds", self.worlds, "must be 1 to 16777216")?;
        require(
            (3..=MAX_FRAMES).contains(&self.frames),
            "data.frames",
            self.frames,
            &format!("must be 3 to {MAX_FRAMES}: a snippet is three frames"),
        )?;
        require((0.0..=0.5).contains(&self.noise), "data.noise", self.noise, "must be between 0 and 0.5")?;
        require((0.0..=1.0).contains(&self.exposure), "data.exposure", self.exposure, "must be between 0 and 1")
    }
}

/// The networks halve the picture five times.
fn side(key: &'static str, value: usize) -> Result<(), ConfigError> {
    let ok = (64..=4096).contains(&value) && value.is_multiple_of(32);
    require(ok, key, value, "must be a multiple of 32 between 64 and 4096")
}
