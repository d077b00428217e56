//! Settings of the local-structure loss `L_loc`.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::ConfigError;
use super::error::{not_negative, require};

/// Where the pseudo-depth of the local-structure loss comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PseudoDepth {
    /// No pseudo-depth: the loss is left out.
    #[default]
    None,
    /// The network's own depth, smoothed with the picture as guide: needs no teacher.
    SelfGuided,
    /// The true depth of the embedded world, degraded: a teacher that knows the local structure and no scale.
    Rendered,
    /// Maps that some other network made, read from `folder`.
    Folder,
}

impl PseudoDepth {
    /// What configuration files call it.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::SelfGuided => "self-guided",
            Self::Rendered => "rendered",
            Self::Folder => "folder",
        }
    }
}

/// How the true depth of a world is made as uncertain as a predicted one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DegradationConfig {
    /// The scale of a frame is drawn between 1 / scale and scale.
    pub scale: f64,
    /// Largest logarithm of the noise factor of a pixel.
    pub noise: f64,
    /// Pixels between the nodes of the noise.
    pub wavelength: usize,
}

impl Default for DegradationConfig {
    fn default() -> Self {
        Self { scale: 2.0, noise: 0.05, wavelength: 16 }
    }
}

/// Settings of the local-structure loss: weights of its terms relative to each other (`lambda3` of the stage weighs them all), and
/// its teacher.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LocalStructure {
    /// Difference of the surface normals of predicted and pseudo-depth.
    pub normal_matching: f64,
    /// Difference of the angles between normals across edges.
    pub relative_normal: f64,
    /// Order of depths in pairs where the pseudo-depth is sure of it.
    pub depth_ranking: f64,
    /// Source of the pseudo-depth.
    pub pseudo_depth: PseudoDepth,
    /// Folder of pseudo-depth maps, `FOLDER/SEQUENCE/NAME.png` or, as `dimode infer` writes them, `FOLDER/SEQUENCE/depth/NAME.png`;
    /// 16-bit, 0 unknown.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub folder: Option<PathBuf>,
    /// What `rendered` does to the true depth.
    pub degradation: DegradationConfig,
}

impl Default for LocalStructure {
    fn default() -> Self {
        Self {
            normal_matching: 1.0,
            relative_normal: 0.0,
            depth_ranking: 0.0,
            pseudo_depth: PseudoDepth::None,
            folder: None,
            degradation: DegradationConfig::default(),
        }
    }
}

impl LocalStructure {
    /// **Errors** [`ConfigError::Value`] for the first value out of range.
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        not_negative("loss.local_structure.normal_matching", self.normal_matching)?;
        not_negative("loss.local_structure.relative_normal", self.relative_normal)?;
        not_negative("loss.local_structure.depth_ranking", self.depth_ranking)?;
        let folder = self.folder.as_ref().map_or("none".to_owned(), |path| path.display().to_string());
        let key = "loss.local_structure.folder";
        let named = self.folder.is_some() || self.pseudo_depth != PseudoDepth::Folder;
        require(named, key, &folder, "name the folder of the maps, or choose another loss.local_structure.pseudo_depth")?;
        let utf8 = self.folder.as_ref().is_none_or(|path| path.to_str().is_some());
        require(utf8, key, &folder, "must be valid UTF-8: rename the folder")?;
        let DegradationConfig { scale, noise, wavelength } = self.degradation;
        let key = "loss.local_structure.degradation.scale";
        require(scale.is_finite() && scale >= 1.0, key, scale, "must be a finite number, 1 or more")?;
        not_negative("loss.local_structure.degradation.noise", noise)?;
        let key = "loss.local_structure.degradation.wavelength";
        require((1..=4096).contains(&wavelength), key, wavelength, "must be 1 to 4096")
    }
}
