//! Derivatives of the axial forms with respect to the flows: one vector a flow, in units of the loss per pixel (L44).

use nalgebra::Vector2;

use super::sign_of_flows;
use crate::loss_forms::planar::gradients::angle as direction_angle;

/// Derivative of the angle `atan2(|f x d|, s f . d)`: `sign(s (d x f)) (-f_v, f_u) / |f|^2`, rad per pixel.
///
/// `1 / |f|` long everywhere, with a jump where flow and radius are parallel, where 0 is returned.
#[must_use]
pub fn angle(f: &Vector2<f64>, d: &Vector2<f64>, s: f64) -> Vector2<f64> {
    let side = s * d.perp(f);
    if side == 0.0 { Vector2::zeros() } else { direction_angle(f) * side.signum() }
}

fn angles(flows: &[Vector2<f64>], d: &[Vector2<f64>], sign: impl Fn(&Vector2<f64>, &Vector2<f64>) -> f64) -> Vec<Vector2<f64>> {
    flows.iter().zip(d).map(|(f, d)| angle(f, d, sign(f, d)) / flows.len() as f64).collect()
}

/// Gradient of [`super::printed`].
#[must_use]
pub fn printed(flows: &[Vector2<f64>], d: &[Vector2<f64>]) -> Vec<Vector2<f64>> {
    angles(flows, d, |_, _| 1.0)
}

/// Gradient of [`super::folded`]: every flow is compared with the side of the radius it is closer to.
#[must_use]
pub fn folded(flows: &[Vector2<f64>], d: &[Vector2<f64>]) -> Vec<Vector2<f64>> {
    angles(flows, d, |f, d| f.dot(d))
}

/// Gradient of [`super::pose_sign`]; `a_z` enters by its sign only and gets none.
#[must_use]
pub fn pose_sign(flows: &[Vector2<f64>], d: &[Vector2<f64>], a_z: f64) -> Vec<Vector2<f64>> {
    angles(flows, d, |_, _| -a_z.signum())
}

/// Gradient of [`super::flow_sign`]; the common sign gets none.
#[must_use]
pub fn flow_sign(flows: &[Vector2<f64>], d: &[Vector2<f64>]) -> Vec<Vector2<f64>> {
    let sign = sign_of_flows(flows, d);
    angles(flows, d, |_, _| sign)
}

/// Gradient of [`super::smooth`]: `(2/N) (d x f) (d . f) / (f.f d.d) (-f_v, f_u) / f.f`, continuous through the solution.
#[must_use]
pub fn smooth(flows: &[Vector2<f64>], d: &[Vector2<f64>]) -> Vec<Vector2<f64>> {
    let share = 2.0 / flows.len() as f64;
    let one = |(f, d): (&Vector2<f64>, &Vector2<f64>)| {
        direction_angle(f) * (share * d.perp(f) * d.dot(f) / (f.norm_squared() * d.norm_squared()))
    };
    flows.iter().zip(d).map(one).collect()
}

/// Gradient of [`super::perpendicular`]: `sign(f x d) (d_v, -d_u) / (N |d|)`; 0 on the radius.
#[must_use]
pub fn perpendicular(flows: &[Vector2<f64>], d: &[Vector2<f64>]) -> Vec<Vector2<f64>> {
    let one = |(f, d): (&Vector2<f64>, &Vector2<f64>)| {
        let across = Vector2::new(d.y, -d.x) / (d.norm() * flows.len() as f64);
        if f.perp(d) == 0.0 { Vector2::zeros() } else { across * f.perp(d).signum() }
    };
    flows.iter().zip(d).map(one).collect()
}
