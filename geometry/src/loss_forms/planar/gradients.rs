//! Derivatives of the planar forms with respect to the flows: one vector a flow, in units of the loss per pixel (L38, L39).

use nalgebra::Vector2;

use crate::loss_forms::mean;

/// `d theta / df = (-f_v, f_u) / |f|^2` of the angle `theta = atan2(f_v, f_u)`, rad per pixel. Not defined at `f = 0`.
#[must_use]
pub fn angle(f: &Vector2<f64>) -> Vector2<f64> {
    Vector2::new(-f.y, f.x) / f.norm_squared()
}

/// Derivative of the printed angle `arccos(f_u / |f|) = |theta|`: `sign(f_v) (-f_v, f_u) / |f|^2`.
///
/// At most `1 / |f|` long, with a jump at `f_v = 0`, where 0 is returned.
#[must_use]
pub fn folded_angle(f: &Vector2<f64>) -> Vector2<f64> {
    if f.y == 0.0 { Vector2::zeros() } else { angle(f) * f.y.signum() }
}

/// `d arccos(c) / dc = -1 / sqrt(1 - c^2)` at `c = f_u / |f|`: `-|f| / |f_v|`, infinite for horizontal flows.
///
/// The chain rule multiplies it by `dc/df`, which vanishes there: infinity times zero.
#[must_use]
pub fn arccos_slope(f: &Vector2<f64>) -> f64 {
    -f.norm() / f.y.abs()
}

/// `(2/N) (x_i - E[x]) dx_i` of a population variance.
fn of_variance(
    flows: &[Vector2<f64>],
    value: impl Fn(&Vector2<f64>) -> f64,
    slope: impl Fn(&Vector2<f64>) -> Vector2<f64>,
) -> Vec<Vector2<f64>> {
    let centre = mean(flows.iter().map(&value));
    let share = 2.0 / flows.len() as f64;
    flows.iter().map(|f| slope(f) * (share * (value(f) - centre))).collect()
}

/// Gradient of [`super::printed`]: `(2/N) (|theta_i| - E|theta|) sign(f_v) (-f_v, f_u) / |f_i|^2`.
#[must_use]
pub fn printed(flows: &[Vector2<f64>]) -> Vec<Vector2<f64>> {
    of_variance(flows, |f| f.y.abs().atan2(f.x), folded_angle)
}

/// Gradient of [`super::unfolded`]: `(2/N) (theta_i - E[theta]) (-f_v, f_u) / |f_i|^2`.
#[must_use]
pub fn unfolded(flows: &[Vector2<f64>]) -> Vec<Vector2<f64>> {
    of_variance(flows, |f| f.y.atan2(f.x), angle)
}

/// Gradient of [`super::circular`]: `(2/N) sin(theta_i - theta_mean) (-f_v, f_u) / |f_i|^2`.
///
/// Not defined where the unit vectors cancel.
#[must_use]
pub fn circular(flows: &[Vector2<f64>]) -> Vec<Vector2<f64>> {
    let sum: Vector2<f64> = flows.iter().map(|f| f / f.norm()).sum();
    let direction = sum / sum.norm();
    let share = 2.0 / flows.len() as f64;
    flows.iter().map(|f| angle(f) * (share * direction.perp(f) / f.norm())).collect()
}

/// Gradient of [`super::weighted`]: `-(2/S) (m - (|sum f| / S) f_i / |f_i|)` with `S = sum |f|` and the unit vector
/// `m = sum f / |sum f|`: bounded by `4/S`, however short the flow.
#[must_use]
pub fn weighted(flows: &[Vector2<f64>]) -> Vec<Vector2<f64>> {
    let sum: Vector2<f64> = flows.iter().sum();
    let total: f64 = flows.iter().map(|f| f.norm()).sum();
    let direction = sum / sum.norm();
    flows.iter().map(|f| (direction - f * (sum.norm() / total / f.norm())) * (-2.0 / total)).collect()
}

/// Gradient of [`super::perpendicular`]: `sign(f_i x n) (n_v, -n_u) / N`; 0 on the line.
#[must_use]
pub fn perpendicular(flows: &[Vector2<f64>], direction: &Vector2<f64>) -> Vec<Vector2<f64>> {
    let n = direction / direction.norm();
    let across = Vector2::new(n.y, -n.x) / flows.len() as f64;
    flows.iter().map(|f| if f.perp(&n) == 0.0 { Vector2::zeros() } else { across * f.perp(&n).signum() }).collect()
}
