//! What pixel noise alone costs the direction losses (L40, L45).
//!
//! `sigma` is the standard deviation of each component of the aligned flow, pixels, independent between components and pixels.

use nalgebra::{Vector2, Vector3};

use crate::camera::Intrinsics;
use crate::flow::tangential::tangential_flow;
use crate::loss_forms::mean;

/// Variance of a folded angle that is uniform on `[0, pi]`, rad^2: what [`crate::loss_forms::planar::printed`] tends to when
/// the flows have no common direction at all.
pub const PRINTED_CEILING: f64 = std::f64::consts::PI * std::f64::consts::PI / 12.0;

/// The same limit of [`crate::loss_forms::planar::circular`] and of the weighted form.
pub const CIRCULAR_CEILING: f64 = 2.0;

/// Mean angle to the radius when flows have no direction, rad: of the signed forms, and half of it for the folded one.
pub const AXIAL_CEILING: f64 = std::f64::consts::FRAC_PI_2;

/// Angle variance of planar flows, rad^2: `E[sigma^2 / |f|^2] = E[sigma^2 z^2 / |f o a_tan|^2]`.
///
/// **Domain**: first order in `sigma / |f|`; a value near [`PRINTED_CEILING`] says that the angles are noise.
#[must_use]
pub fn planar_angle_variance(camera: &Intrinsics, a: &Vector3<f64>, depths: &[f64], sigma: f64) -> f64 {
    mean(depths.iter().map(|&z| (sigma * sigma) / tangential_flow(camera, a, z).norm_squared()))
}

/// Mean angle between axial flows and radius, rad: `sqrt(2/pi) sigma E[z' / (r |a_z|)]`, `z' = z + a_z`, `r = |d|`.
///
/// The mean of `|x|` for a normal `x` of deviation `sigma / |f|`, with `|f| = |a_z| r / z'`.
/// **Domain**: first order in `sigma / |f|`; far below [`AXIAL_CEILING`]. Infinite with a pixel at the principal point.
#[must_use]
pub fn axial_angle_mean(d: &[Vector2<f64>], depths: &[f64], a_z: f64, sigma: f64) -> f64 {
    let share = (2.0 / std::f64::consts::PI).sqrt() * sigma;
    share * mean(d.iter().zip(depths).map(|(d, z)| (z + a_z) / (d.norm() * a_z.abs())))
}
