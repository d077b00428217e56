//! Where the pseudo-depth `D*` of the local structure loss comes from. It is data: no gradient passes.
//!
//! [`external`] fits maps that were read from files, [`degraded`] makes the true depth of a rendered scene as uncertain as a
//! predicted one, and [`self_guided`](super::guided_filter::self_guided) filters the network's own depth with the image as guide.
//!
//! The losses that use it look at normals or ratios, so its scale does not matter; a shift or an inverse depth of unknown shift
//! does. Only external maps are comparable with published numbers.

use dimode_autodiff::{Scalar, Shape, Tape, Tensor, rng};

/// How a true depth map is made as uncertain as a predicted one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Degradation {
    /// The scale of a sample is drawn between `1 / scale` and `scale`, uniformly in its logarithm; at least 1.
    pub scale: f64,
    /// Largest logarithm of the noise factor of a pixel; at least 0.
    pub noise: f64,
    /// Pixels between the nodes of the noise; at least 1.
    pub wavelength: usize,
    /// Seed of both.
    pub seed: u64,
}

impl Default for Degradation {
    fn default() -> Self {
        Self { scale: 2.0, noise: 0.05, wavelength: 16, seed: 0 }
    }
}

/// A pseudo-depth map holds a number that is no depth.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("pseudo-depth of sample {sample} is {value} at row {row}, column {column}; every pixel needs a finite depth above 0")]
pub struct NotADepth {
    /// Which sample.
    pub sample: usize,
    /// Row of the map as read.
    pub row: usize,
    /// Column of the map as read.
    pub column: usize,
    /// What stands there.
    pub value: f64,
}

/// Maps `[n, 1, h', w']` bilinear-resized (half-pixel centres) to `height` x `width`.
///
/// # Errors
/// When a pixel has no finite positive depth: a hole would be blended into its neighbours.
pub fn external<T: Scalar>(map: &Tensor<T>, height: usize, width: usize) -> Result<Tensor<T>, NotADepth> {
    all_depths(map)?;
    let tape = Tape::new();
    Ok(tape.constant(map.clone()).resize_bilinear(height, width, false).value())
}

/// `s_n exp(e(p)) D(p)` of true depth maps `[n, 1, h, w]`: a scale for each sample and noise that is drawn at nodes and
/// interpolated between them.
///
/// # Panics
/// When a setting is out of its range.
#[must_use]
#[track_caller]
pub fn degraded<T: Scalar>(depth: &Tensor<T>, settings: Degradation) -> Tensor<T> {
    let Degradation { scale, noise, wavelength, seed } = settings;
    assert!(scale >= 1.0 && noise >= 0.0 && wavelength >= 1, "degraded: {settings:?} is out of range");
    let s = depth.shape();
    let factors = Shape::new(s.n(), 1, 1, 1);
    let scales = rng::uniform::<f64>(rng::splitmix64(seed, 0), factors, -scale.ln(), scale.ln());
    let nodes = Shape::new(s.n(), 1, s.h().div_ceil(wavelength) + 1, s.w().div_ceil(wavelength) + 1);
    let nodes = rng::uniform::<f64>(rng::splitmix64(seed, 1), nodes, -noise, noise);
    let tape = Tape::new();
    let smooth = tape.constant(nodes).resize_bilinear(s.h(), s.w(), true).value();
    Tensor::from_fn(s, |n, c, h, w| {
        let factor = (scales.at(n, 0, 0, 0) + smooth.at(n, 0, h, w)).exp();
        T::from_f64(depth.at(n, c, h, w).to_f64() * factor)
    })
}

fn all_depths<T: Scalar>(map: &Tensor<T>) -> Result<(), NotADepth> {
    let bad = map.data().iter().position(|&d| !(d.is_finite() && d > T::ZERO));
    bad.map_or(Ok(()), |at| {
        let [sample, _, row, column] = map.shape().unravel(at);
        Err(NotADepth { sample, row, column, value: map.data()[at].to_f64() })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::gradcheck::random;
    use dimode_geometry::Intrinsics;

    use crate::losses::local_structure::normal_matching;

    fn scene() -> (Tensor<f64>, Tensor<f64>) {
        (random(1, Shape::new(2, 1, 8, 10), 2.0, 5.0), random(2, Shape::new(2, 3, 8, 10), 0.0, 1.0))
    }

    #[test]
    fn maps_are_resized_by_areas_and_holes_are_named() {
        let row = |values: [f64; 4]| Tensor::from_vec(Shape::new(1, 1, 1, 4), values.to_vec());
        let map = row([1.0, 2.0, 3.0, 4.0]);
        assert_eq!(external(&map, 1, 2).unwrap().data(), [1.5, 3.5]);
        assert_eq!(external(&map, 1, 4).unwrap(), map);
        let error = external(&row([1.0, 2.0, 0.0, 4.0]), 1, 2).unwrap_err();
        assert_eq!(error, NotADepth { sample: 0, row: 0, column: 2, value: 0.0 });
        assert_eq!(
            error.to_string(),
            "pseudo-depth of sample 0 is 0 at row 0, column 2; every pixel needs a finite depth above 0"
        );
        assert!(external(&row([1.0, f64::NAN, 2.0, 4.0]), 1, 2).is_err());
    }

    #[test]
    fn degradation_is_a_scale_and_smooth_noise_within_its_bounds() {
        let depth = Tensor::full(Shape::new(3, 1, 33, 49), 4.0_f64);
        let settings = Degradation { scale: 3.0, noise: 0.1, wavelength: 16, seed: 5 };
        let found = degraded(&depth, settings);
        assert_eq!(found, degraded(&depth, settings));
        assert_ne!(found, degraded(&depth, Degradation { seed: 6, ..settings }));
        let log = |n, h, w| (found.at(n, 0, h, w) / 4.0_f64).ln();
        let mut scales = Vec::new();
        for n in 0..3 {
            let all: Vec<f64> = (0..33).flat_map(|h| (0..49).map(move |w| log(n, h, w))).collect();
            let (lo, hi) = all.iter().fold((f64::MAX, f64::MIN), |(a, b), &x| (a.min(x), b.max(x)));
            assert!(hi - lo > 0.02 && hi - lo <= 0.2, "{lo} {hi}");
            assert!(lo >= -3.0_f64.ln() - 0.1 && hi <= 3.0_f64.ln() + 0.1);
            // Neighbours differ by at most the range of the noise over the distance of its nodes, along both axes.
            assert!((0..33).all(|h| (1..49).all(|w| (log(n, h, w) - log(n, h, w - 1)).abs() <= 0.2 / 12.0)));
            scales.push(all.iter().sum::<f64>() / all.len() as f64);
        }
        assert!((scales[0] - scales[1]).abs() > 0.01);
    }

    #[test]
    fn without_noise_the_degraded_depth_is_as_good_as_the_true_one() {
        let (depth, _) = scene();
        let settings = Degradation { noise: 0.0, ..Degradation::default() };
        let tape = Tape::new();
        let cameras = vec![Intrinsics::new(9.0, 9.0, 4.5, 3.5, 10, 8).unwrap(); 2];
        let loss = |settings| {
            let pseudo = degraded(&depth, settings);
            normal_matching(tape.constant(depth.clone()), &pseudo, &cameras).value().item()
        };
        assert!(loss(settings) < 1e-12);
        assert!(loss(Degradation { noise: 0.3, wavelength: 2, ..settings }) > 1e-3);
    }
}
