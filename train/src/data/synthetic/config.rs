//! What a synthetic dataset is made of: preset, size, seed, split, options.

use std::fmt;
use std::str::FromStr;

use dimode_geometry::Intrinsics;
use serde::{Deserialize, Serialize};

use super::random::mix;
use crate::data::DataError;

/// Most frames of a sequence.
pub const MAX_FRAMES: usize = 5000;

/// The kind of world and of camera motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Preset {
    /// Driving forward on a bending road between facades, parked cars, posts and trees.
    Street,
    /// A camera turned and carried by hand through a room or courtyard: large rotations, any direction of translation.
    Handheld,
    /// A camera that moves sideways past a scene 2 to 30 m ahead, with hardly any rotation.
    Lateral,
}

impl Preset {
    /// Every preset, in the order of documentation.
    pub const ALL: [Self; 3] = [Self::Street, Self::Handheld, Self::Lateral];

    /// The lower-case name used in files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Street => "street",
            Self::Handheld => "handheld",
            Self::Lateral => "lateral",
        }
    }
}

impl fmt::Display for Preset {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for Preset {
    type Err = DataError;

    fn from_str(text: &str) -> Result<Self, DataError> {
        Self::ALL.into_iter().find(|preset| preset.name() == text).ok_or_else(|| DataError::Option {
            option: "preset",
            value: text.to_owned(),
            reason: "no such preset; use street, handheld or lateral".to_owned(),
        })
    }
}

/// Which family of worlds is drawn; the two families share no world seed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Split {
    /// Worlds to learn from.
    Train,
    /// Worlds that are never learned from.
    HeldOut,
}

impl Split {
    /// The name used in files and reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::HeldOut => "held-out",
        }
    }
}

/// Everything that decides what a synthetic dataset shows. Two equal configurations give equal bits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SyntheticConfig {
    /// Kind of world and motion.
    pub preset: Preset,
    /// Columns of a frame, at least 16.
    pub width: usize,
    /// Rows of a frame, at least 16.
    pub height: usize,
    /// The seed that, with the split and the number of the sequence, decides every world.
    pub seed: u64,
    /// Family of worlds.
    pub split: Split,
    /// Number of sequences, each in a world of its own.
    pub sequences: usize,
    /// Frames a sequence has, 1 to [`MAX_FRAMES`].
    pub frames: usize,
    /// Standard deviation of Gaussian noise added to each colour value in [0, 1]; 0 for none, at most 0.5.
    pub noise: f64,
    /// Strength of exposure changes from frame to frame: standard deviation of the logarithm of the gain, and of the
    /// exponent by half as much; 0 for none, at most 1.
    pub exposure: f64,
    /// Dark worlds lit by a light cone that moves with the camera, so that brightness constancy does not hold.
    pub night: bool,
    /// Adds a box that moves on its own through the view.
    pub moving_object: bool,
}

impl Default for SyntheticConfig {
    fn default() -> Self {
        Self {
            preset: Preset::Street,
            width: 128,
            height: 64,
            seed: 0,
            split: Split::Train,
            sequences: 64,
            frames: 32,
            noise: 0.0,
            exposure: 0.0,
            night: false,
            moving_object: false,
        }
    }
}

/// An error about one option.
fn refuse(option: &'static str, value: String, reason: &str) -> Result<(), DataError> {
    Err(DataError::Option { option, value, reason: reason.to_owned() })
}

impl SyntheticConfig {
    /// The camera of every frame: square pixels, focal length 0.75 of the width, principal point in the centre of the image.
    pub fn intrinsics(&self) -> Intrinsics {
        let focal = 0.75 * self.width as f64;
        Intrinsics {
            fu: focal,
            fv: focal,
            u0: 0.5 * (self.width as f64 - 1.0),
            v0: 0.5 * (self.height as f64 - 1.0),
            width: self.width,
            height: self.height,
        }
    }

    /// The seed of the world of one sequence. Its lowest bit tells the split, so that training and held-out worlds differ.
    pub fn world_seed(&self, sequence: usize) -> u64 {
        let mixed = mix(mix(self.seed) ^ mix(sequence as u64 ^ 0x5eed_0000_0000_0000));
        (mixed & !1) | u64::from(self.split == Split::HeldOut)
    }

    /// Checks every field.
    ///
    /// **Errors** with [`DataError::Option`] naming the first field that cannot be used.
    pub fn validate(&self) -> Result<(), DataError> {
        for (option, size) in [("width", self.width), ("height", self.height)] {
            if !(16..=4096).contains(&size) {
                return refuse(option, size.to_string(), "a frame has 16 to 4096 pixels a side");
            }
        }
        if self.sequences == 0 {
            return refuse("sequences", "0".to_owned(), "at least one sequence is needed");
        }
        if !(1..=MAX_FRAMES).contains(&self.frames) {
            return refuse("frames", self.frames.to_string(), &format!("a sequence has 1 to {MAX_FRAMES} frames"));
        }
        for (option, value, limit) in [("noise", self.noise, 0.5), ("exposure", self.exposure, 1.0)] {
            if !(0.0..=limit).contains(&value) {
                return refuse(option, value.to_string(), &format!("use a number from 0 to {limit}"));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn splits_share_no_world_seed_and_worlds_differ() {
        let train = SyntheticConfig::default();
        let held_out = SyntheticConfig { split: Split::HeldOut, ..train.clone() };
        let mut seeds: Vec<u64> = (0..1000).flat_map(|s| [train.world_seed(s), held_out.world_seed(s)]).collect();
        assert!((0..1000).all(|s| train.world_seed(s) & 1 == 0 && held_out.world_seed(s) & 1 == 1));
        seeds.sort_unstable();
        seeds.dedup();
        assert_eq!(seeds.len(), 2000);
    }

    #[test]
    fn default_camera_has_focal_96_at_the_centre() {
        let k = SyntheticConfig::default().intrinsics();
        assert_eq!((k.fu, k.fv, k.u0, k.v0), (96.0, 96.0, 63.5, 31.5));
    }

    #[test]
    fn bad_fields_are_named() {
        let bad = |change: fn(&mut SyntheticConfig)| {
            let mut config = SyntheticConfig::default();
            change(&mut config);
            config.validate().unwrap_err().to_string()
        };
        assert!(SyntheticConfig::default().validate().is_ok());
        assert!(bad(|c| c.width = 3).starts_with("width = 3"));
        assert!(bad(|c| c.sequences = 0).starts_with("sequences = 0"));
        assert!(bad(|c| c.frames = 0).starts_with("frames = 0"));
        assert!(bad(|c| c.noise = f64::NAN).starts_with("noise = NaN"));
        assert!(bad(|c| c.exposure = -1.0).starts_with("exposure = -1"));
    }

    #[test]
    fn preset_names_round_trip() {
        for preset in Preset::ALL {
            assert_eq!(preset.name().parse::<Preset>().unwrap(), preset);
        }
        assert!("tunnel".parse::<Preset>().is_err());
    }
}
