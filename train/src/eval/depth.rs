//! The seven depth metrics, one image at a time, and their plain mean over images.
//!
//! Order of operations for one image: take the pixels whose true depth lies strictly between the bounds and inside the
//! crop and the mask; bring the prediction to the scale of the truth by the ratio of medians; clamp it to the bounds;
//! compare. A table value is the mean of the per-image values, so an image with many points weighs no more than one with
//! few. Images without a valid pixel are left out and counted.

use serde::Serialize;

use super::EvalError;
use super::depth_protocol::{DepthProtocol, DepthScaling};
use crate::data::Map;

/// The seven numbers. Lower is better for the first four, higher for the last three.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct DepthScores {
    /// mean(|g - p| / g).
    pub abs_rel: f64,
    /// mean((g - p)^2 / g), metres.
    pub sq_rel: f64,
    /// sqrt(mean((g - p)^2)), metres.
    pub rmse: f64,
    /// sqrt(mean((ln g - ln p)^2)).
    pub rmse_log: f64,
    /// Share of pixels with max(g / p, p / g) below 1.25.
    pub a1: f64,
    /// The same below 1.25^2.
    pub a2: f64,
    /// The same below 1.25^3.
    pub a3: f64,
}

impl DepthScores {
    /// Names in the order of [`DepthScores::values`]; also the keys in JSON.
    pub const NAMES: [&'static str; 7] = ["abs_rel", "sq_rel", "rmse", "rmse_log", "a1", "a2", "a3"];

    /// The seven numbers in the order of [`DepthScores::NAMES`].
    pub fn values(&self) -> [f64; 7] {
        [self.abs_rel, self.sq_rel, self.rmse, self.rmse_log, self.a1, self.a2, self.a3]
    }

    fn from_values(v: [f64; 7]) -> Self {
        let [abs_rel, sq_rel, rmse, rmse_log, a1, a2, a3] = v;
        Self { abs_rel, sq_rel, rmse, rmse_log, a1, a2, a3 }
    }

    /// Compares depths in metres pixel by pixel. Both slices have the same non-zero length and hold positive values.
    fn compare(truth: &[f64], prediction: &[f64]) -> Self {
        let mut sums = [0.0f64; 7];
        for (&g, &p) in truth.iter().zip(prediction) {
            let difference = g - p;
            let worst = (g / p).max(p / g);
            sums[0] += difference.abs() / g;
            sums[1] += difference * difference / g;
            sums[2] += difference * difference;
            sums[3] += (g.ln() - p.ln()).powi(2);
            for (k, limit) in [1.25f64, 1.5625, 1.953_125].into_iter().enumerate() {
                sums[4 + k] += f64::from(u8::from(worst < limit));
            }
        }
        let mut v = sums.map(|sum| sum / truth.len() as f64);
        v[2] = v[2].sqrt();
        v[3] = v[3].sqrt();
        Self::from_values(v)
    }
}

/// Result of one image.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct DepthImage {
    /// The seven numbers.
    #[serde(flatten)]
    pub scores: DepthScores,
    /// How many pixels were compared.
    pub valid_pixels: usize,
    /// The factor put on the prediction.
    pub scale: f64,
    /// Predictions raised to the lower bound by the clamp.
    pub below_min: usize,
    /// Predictions lowered to the upper bound by the clamp.
    pub above_max: usize,
}

/// Means over images.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DepthSummary {
    /// Mean of the per-image numbers.
    #[serde(flatten)]
    pub scores: DepthScores,
    /// Images that were compared.
    pub images: usize,
    /// Images left out because no pixel was valid.
    pub skipped: usize,
    /// Median of the scale factors.
    pub scale_median: f64,
    /// Population standard deviation of scale / median scale: 0 when all images agree on one scale.
    pub scale_spread: f64,
    /// Each image in the order of arrival.
    pub per_image: Vec<DepthImage>,
}

/// Collects images and gives their mean.
#[derive(Clone, Debug)]
pub struct DepthEvaluator {
    protocol: DepthProtocol,
    images: Vec<DepthImage>,
    skipped: usize,
}

impl DepthEvaluator {
    /// **Errors** when the bounds of the protocol make no sense.
    pub fn new(protocol: DepthProtocol) -> Result<Self, EvalError> {
        protocol.check()?;
        Ok(Self { protocol, images: Vec::new(), skipped: 0 })
    }

    /// Compares one image; `None` when it has no valid pixel. Arguments and errors as [`evaluate_depth_image`].
    pub fn add(&mut self, prediction: &Map, truth: &Map, mask: Option<&[bool]>) -> Result<Option<DepthImage>, EvalError> {
        let image = evaluate_depth_image(&self.protocol, prediction, truth, mask)?;
        match image {
            Some(image) => self.images.push(image),
            None => self.skipped += 1,
        }
        Ok(image)
    }

    /// The means. **Errors** when no image had a valid pixel.
    pub fn finish(self) -> Result<DepthSummary, EvalError> {
        if self.images.is_empty() {
            return Err(EvalError::NoValidPixels { images: self.skipped });
        }
        let count = self.images.len() as f64;
        let mut mean = [0.0f64; 7];
        for image in &self.images {
            for (sum, value) in mean.iter_mut().zip(image.scores.values()) {
                *sum += value / count;
            }
        }
        let mut scales: Vec<f64> = self.images.iter().map(|image| image.scale).collect();
        let scale_median = median(&mut scales, false);
        let relative = scales.iter().map(|scale| scale / scale_median);
        let centre = relative.clone().sum::<f64>() / count;
        let spread = relative.map(|r| (r - centre).powi(2)).sum::<f64>() / count;
        Ok(DepthSummary {
            scores: DepthScores::from_values(mean),
            images: self.images.len(),
            skipped: self.skipped,
            scale_median,
            scale_spread: spread.sqrt(),
            per_image: self.images,
        })
    }
}

/// Compares one predicted depth map with the truth (metres, 0 unknown) of the same size. `mask` (one flag per pixel, row by
/// row) restricts the pixels further. `None` when no pixel is valid.
///
/// **Errors** for different sizes, values that are not finite, and predictions at or below zero where they count.
pub fn evaluate_depth_image(
    protocol: &DepthProtocol,
    prediction: &Map,
    truth: &Map,
    mask: Option<&[bool]>,
) -> Result<Option<DepthImage>, EvalError> {
    let (g, mut p) = valid_pairs(protocol, prediction, truth, mask)?;
    if g.is_empty() {
        return Ok(None);
    }
    let lower = protocol.scaling == DepthScaling::LowerMedian;
    let scale = match protocol.scaling {
        DepthScaling::None => 1.0,
        _ => median(&mut g.clone(), lower) / median(&mut p.clone(), lower),
    };
    p.iter_mut().for_each(|p| *p *= scale);
    let (mut below_min, mut above_max) = (0, 0);
    if protocol.clamp {
        below_min = p.iter().filter(|p| **p < protocol.min_depth).count();
        above_max = p.iter().filter(|p| **p > protocol.max_depth).count();
        p.iter_mut().for_each(|p| *p = p.clamp(protocol.min_depth.max(f64::MIN_POSITIVE), protocol.max_depth));
    }
    Ok(Some(DepthImage { scores: DepthScores::compare(&g, &p), valid_pixels: g.len(), scale, below_min, above_max }))
}

/// True and predicted depths of the pixels that count.
fn valid_pairs(
    protocol: &DepthProtocol,
    prediction: &Map,
    truth: &Map,
    mask: Option<&[bool]>,
) -> Result<(Vec<f64>, Vec<f64>), EvalError> {
    let size = (truth.height, truth.width);
    if (prediction.height, prediction.width) != size {
        return Err(EvalError::SizeMismatch {
            what: "depth map",
            prediction: (prediction.height, prediction.width),
            truth: size,
        });
    }
    if let Some(mask) = mask.filter(|mask| mask.len() != truth.data.len()) {
        return Err(EvalError::CountMismatch { what: "mask pixels", prediction: mask.len(), truth: truth.data.len() });
    }
    finite("predicted depth", prediction)?;
    finite("true depth", truth)?;
    let [top, bottom, left, right] = protocol.crop.bounds(size.0, size.1);
    let (mut g, mut p) = (Vec::new(), Vec::new());
    for row in top..bottom {
        for column in left..right {
            let i = row * size.1 + column;
            let (true_depth, value) = (truth.data[i], prediction.data[i]);
            if !protocol.counts(true_depth) || mask.is_some_and(|mask| !mask[i]) {
                continue;
            }
            if value <= 0.0 {
                return Err(bad_pixel("predicted depth", row, column, value, "must be positive"));
            }
            g.push(f64::from(true_depth));
            p.push(f64::from(value));
        }
    }
    Ok((g, p))
}

fn bad_pixel(what: &'static str, row: usize, column: usize, value: f32, requirement: &'static str) -> EvalError {
    EvalError::BadPixel { what, row, column, value, requirement }
}

fn finite(what: &'static str, map: &Map) -> Result<(), EvalError> {
    match map.data.iter().position(|value| !value.is_finite()) {
        None => Ok(()),
        Some(i) => Err(bad_pixel(what, i / map.width, i % map.width, map.data[i], "must be finite")),
    }
}

/// Middle value of a non-empty slice, which is sorted on the way. For an even count: mean of the middle two, or the lower.
pub(crate) fn median(values: &mut [f64], lower: bool) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    let (n, half) = (values.len(), values.len() / 2);
    match (n % 2, lower) {
        (1, _) => values[half],
        (_, true) => values[half - 1],
        (_, false) => 0.5 * (values[half - 1] + values[half]),
    }
}

#[cfg(test)]
#[path = "depth_tests.rs"]
mod tests;
