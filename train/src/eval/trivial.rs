//! Predictors that have learned nothing about a frame: the rows that a trained system must clearly beat.

use dimode_geometry::{Se3, so3};
use nalgebra::Vector3;
use serde::Serialize;

use super::EvalError;
use super::motion::MIN_TRUE_STEP;
use super::odometry::mean;
use super::resize::{invert, resize_bilinear};
use crate::data::Map;

/// A depth map that does not depend on the picture.
#[derive(Clone, Debug, PartialEq)]
pub enum TrivialDepth {
    /// The same depth everywhere, metres. Under median scaling any positive value gives the same result.
    Constant(f32),
    /// The inverse of a mean disparity map, see [`MeanDisparity`].
    MeanDisparity(Map),
}

impl TrivialDepth {
    /// Name of the row in tables.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Constant(_) => "constant depth",
            Self::MeanDisparity(_) => "mean disparity map",
        }
    }

    /// Depth of the given size in metres.
    pub fn predict(&self, height: usize, width: usize) -> Map {
        match self {
            Self::Constant(value) => Map { height, width, data: vec![*value; height * width] },
            Self::MeanDisparity(disparity) => invert(&resize_bilinear(disparity, height, width)),
        }
    }
}

/// Collects training depth maps and gives their mean disparity (1 / depth) per pixel.
#[derive(Clone, Debug, Default)]
pub struct MeanDisparity {
    size: Option<(usize, usize)>,
    sums: Vec<f64>,
    counts: Vec<u32>,
}

impl MeanDisparity {
    /// Nothing collected yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds one depth map in metres; pixels that are not positive or not finite are unknown and left out.
    ///
    /// **Errors** when its size differs from the maps before.
    pub fn add(&mut self, depth: &Map) -> Result<(), EvalError> {
        let size = (depth.height, depth.width);
        let known = *self.size.get_or_insert(size);
        if known != size {
            return Err(EvalError::SizeMismatch {
                what: "training depth maps (new one, those before)",
                prediction: size,
                truth: known,
            });
        }
        self.sums.resize(depth.data.len(), 0.0);
        self.counts.resize(depth.data.len(), 0);
        for (i, &d) in depth.data.iter().enumerate() {
            if d.is_finite() && d > 0.0 {
                self.sums[i] += 1.0 / f64::from(d);
                self.counts[i] += 1;
            }
        }
        Ok(())
    }

    /// Mean disparity map (1 / metres). A pixel that was never known gets the mean of the others.
    ///
    /// **Errors** when no pixel was ever known.
    pub fn finish(self) -> Result<Map, EvalError> {
        let of_pixel = |(sum, count): (&f64, &u32)| (*count > 0).then(|| sum / f64::from(*count));
        let values: Vec<Option<f64>> = self.sums.iter().zip(&self.counts).map(of_pixel).collect();
        let all = mean(values.iter().flatten().copied());
        let (Some(all), Some((height, width))) = (all, self.size) else {
            return Err(EvalError::TooFew { what: "training depth for the mean disparity map", needed: 1, found: 0 });
        };
        Ok(Map { height, width, data: values.iter().map(|v| v.unwrap_or(all) as f32).collect() })
    }
}

/// Mean disparity of training depth maps in metres (see [`MeanDisparity`]).
///
/// **Errors** for maps of different sizes and when no pixel is known.
pub fn mean_disparity(depths: &[Map]) -> Result<Map, EvalError> {
    let mut collected = MeanDisparity::new();
    depths.iter().try_for_each(|depth| collected.add(depth))?;
    collected.finish()
}

/// The mean motion of a training set: the same rotation and direction whatever the frames show.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MeanMotion {
    /// Mean rotation vector of `source_from_target`, radians.
    pub rotation_vector: [f64; 3],
    /// Mean of the unit translations of `source_from_target`, made a unit vector; zero when they cancel.
    pub direction: [f64; 3],
    /// Mean length of the translations, metres.
    pub step: f64,
    /// Motions behind the mean.
    pub motions: usize,
}

impl MeanMotion {
    /// From training motions `source_from_target`, all of one kind (for instance frame t to frame t + 1; mixing both
    /// directions of time would cancel them).
    ///
    /// **Errors** when there is no motion.
    pub fn fit(motions: &[Se3]) -> Result<Self, EvalError> {
        if motions.is_empty() {
            return Err(EvalError::TooFew { what: "training motions", needed: 1, found: 0 });
        }
        let count = motions.len() as f64;
        let mut rotation = Vector3::zeros();
        let mut direction = Vector3::zeros();
        let mut step = 0.0;
        for motion in motions {
            rotation += so3::log(&motion.rotation) / count;
            let length = motion.translation.norm();
            step += length / count;
            if length >= MIN_TRUE_STEP {
                direction += motion.translation / length;
            }
        }
        let direction = direction.try_normalize(1e-9 * count);
        Ok(Self {
            rotation_vector: rotation.into(),
            direction: direction.unwrap_or_else(Vector3::zeros).into(),
            step,
            motions: motions.len(),
        })
    }

    /// The motion `source_from_target` that is predicted for every pair.
    pub fn motion(&self) -> Se3 {
        Se3::from_rotation_vector(&Vector3::from(self.rotation_vector), Vector3::from(self.direction) * self.step)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(data: &[f32]) -> Map {
        Map { height: 1, width: data.len(), data: data.to_vec() }
    }

    #[test]
    fn mean_disparity_averages_inverses_and_fills_unknown_pixels() {
        let got = mean_disparity(&[map(&[1.0, 2.0, 0.0]), map(&[0.5, 0.0, 0.0])]).unwrap();
        assert_eq!(got.data, vec![1.5, 0.5, 1.0]);
        let depth = TrivialDepth::MeanDisparity(got).predict(1, 3);
        assert_eq!(depth.data, vec![1.0 / 1.5, 2.0, 1.0]);
        assert!(mean_disparity(&[]).is_err());
        assert!(mean_disparity(&[map(&[0.0])]).is_err());
        assert!(mean_disparity(&[map(&[1.0]), map(&[1.0, 2.0])]).is_err());
    }

    #[test]
    fn constant_depth_has_the_asked_size() {
        let got = TrivialDepth::Constant(3.0).predict(2, 5);
        assert_eq!((got.height, got.width, got.data), (2, 5, vec![3.0; 10]));
    }

    #[test]
    fn mean_motion_of_known_motions() {
        let motion = |w: f64, t: [f64; 3]| Se3::from_rotation_vector(&Vector3::new(0.0, w, 0.0), Vector3::from(t));
        let got = MeanMotion::fit(&[motion(0.1, [2.0, 0.0, 0.0]), motion(0.3, [0.0, 0.0, 4.0])]).unwrap();
        assert!((got.rotation_vector[1] - 0.2).abs() < 1e-12);
        assert!((got.step - 3.0).abs() < 1e-12);
        let half = 0.5f64.sqrt();
        assert!((Vector3::from(got.direction) - Vector3::new(half, 0.0, half)).norm() < 1e-12);
        assert!((got.motion().translation.norm() - 3.0).abs() < 1e-12);
        assert!(MeanMotion::fit(&[]).is_err());
    }

    #[test]
    fn opposite_motions_cancel_to_no_direction() {
        let t = Vector3::new(1.0, 0.0, 0.0);
        let motions = [t, -t].map(|t| Se3::from_rotation_vector(&Vector3::zeros(), t));
        assert_eq!(MeanMotion::fit(&motions).unwrap().direction, [0.0; 3]);
    }
}
