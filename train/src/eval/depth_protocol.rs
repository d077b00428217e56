//! The choices behind a depth number: bounds, scale, crop, clamp.

use serde::{Deserialize, Serialize};

use super::EvalError;

/// How a prediction without metric scale is brought to metres.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DepthScaling {
    /// Times median(truth) / median(prediction), an even count taking the mean of the middle two.
    #[default]
    Median,
    /// The same with the lower of the middle two.
    LowerMedian,
    /// The prediction is in metres already.
    None,
}

/// Part of the image that counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Crop {
    /// All of it.
    #[default]
    None,
    /// The usual crop for KITTI: rows 0.40810811 to 0.99189189 and columns 0.03594771 to 0.96405229 of the size.
    Garg,
}

impl Crop {
    /// Rows and columns of the crop as half-open ranges `[rows from, to, columns from, to]`, truncated in double precision.
    pub fn bounds(self, height: usize, width: usize) -> [usize; 4] {
        let part = |fraction: f64, size: usize| (fraction * size as f64) as usize;
        match self {
            Self::None => [0, height, 0, width],
            Self::Garg => {
                [part(0.408_108_11, height), part(0.991_891_89, height), part(0.035_947_71, width), part(0.964_052_29, width)]
            }
        }
    }
}

/// Every choice behind a depth number.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct DepthProtocol {
    /// True depths at or below this are ignored, metres.
    pub min_depth: f64,
    /// True depths at or beyond this are ignored, metres.
    pub max_depth: f64,
    /// How scale is found.
    pub scaling: DepthScaling,
    /// What part of the image counts.
    pub crop: Crop,
    /// Whether the scaled prediction is clamped to the bounds.
    pub clamp: bool,
}

impl Default for DepthProtocol {
    /// 1e-3 to 80 m, median scaling, whole image, clamped.
    fn default() -> Self {
        Self { min_depth: 1e-3, max_depth: 80.0, scaling: DepthScaling::Median, crop: Crop::None, clamp: true }
    }
}

impl DepthProtocol {
    /// The usual KITTI Eigen setting: the default with the Garg crop.
    pub fn kitti_eigen() -> Self {
        Self { crop: Crop::Garg, ..Self::default() }
    }

    /// One line that says how the numbers were made.
    pub fn describe(&self) -> String {
        let scaling = match self.scaling {
            DepthScaling::Median => "median scaling per image",
            DepthScaling::LowerMedian => "lower-median scaling per image",
            DepthScaling::None => "no scaling",
        };
        let crop = match self.crop {
            Crop::None => "no crop",
            Crop::Garg => "Garg crop",
        };
        let clamp = if self.clamp { "clamped" } else { "not clamped" };
        format!("{scaling}, {} to {} m, {clamp}, {crop}", self.min_depth, self.max_depth)
    }

    /// Whether a pixel of this true depth is compared: it lies strictly between the bounds.
    pub fn counts(&self, true_depth: f32) -> bool {
        true_depth > self.min_depth as f32 && true_depth < self.max_depth as f32
    }

    /// **Errors** when the bounds make no sense.
    pub(crate) fn check(&self) -> Result<(), EvalError> {
        if !(self.min_depth.is_finite() && self.min_depth >= 0.0) {
            return Err(EvalError::Option {
                option: "min_depth",
                value: self.min_depth,
                requirement: "must be finite and not negative",
            });
        }
        if !(self.max_depth.is_finite() && self.max_depth > self.min_depth) {
            return Err(EvalError::Option {
                option: "max_depth",
                value: self.max_depth,
                requirement: "must be finite and above min_depth",
            });
        }
        Ok(())
    }
}
