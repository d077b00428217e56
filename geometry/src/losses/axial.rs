//! `L_axi`: axial flows of a static scene point along the radius (eq. `la`).

use dimode_autodiff::{Scalar, Tensor, Var};
use serde::{Deserialize, Serialize};

use super::arccos::arccos;
use super::pair::AxialProducts;
use super::{AlignedPair, Angles, LossOptions, LossTerm};
use crate::taped::masks;
use crate::taped::smooth::{length, soft_abs};
use crate::taped::weighted::weighted_mean;

/// Forms of `L_axi`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum AxialForm {
    /// Mean of `arccos(f . d / (|f| |d|))`, rad, as printed: pi at the truth of a source behind the target.
    Literal,
    /// The same angle by `atan2(|f x d|, f . d)`, with thresholds.
    Signed,
    /// `atan2(|f x d|, |f . d|)`: angle between the lines, in `[0, pi/2]`, right for either source.
    Folded,
    /// `atan2(|f x d|, -sign(a_z) f . d)`: the estimated radial translation says which way flows point.
    PoseSign,
    /// Mean distance `|f x d| / |d|` of the flow from the radial line, in pixels, over `|d| > q_min`.
    PerpendicularPixels,
}

/// Evaluates `L_axi`.
#[must_use]
pub fn axial<'t, T: Scalar>(pair: &AlignedPair<'t, T>, options: &LossOptions) -> LossTerm<'t, T> {
    let (per_image, mask) = match axial_angles(pair, options) {
        Some(Angles { angle, mask }) => (weighted_mean(angle, &mask), mask),
        None => perpendicular(pair, options),
    };
    LossTerm::new(per_image, &mask, options.min_valid_share)
}

/// The angles whose mean `L_axi` is, in the form that the options ask for; `None` for the form in pixels.
#[must_use]
pub fn axial_angles<'t, T: Scalar>(pair: &AlignedPair<'t, T>, options: &LossOptions) -> Option<Angles<'t, T>> {
    Some(match options.axial {
        AxialForm::Literal => literal(pair),
        AxialForm::PerpendicularPixels => return None,
        AxialForm::Signed => angle(pair, options, |p| p.along),
        AxialForm::Folded => angle(pair, options, |p| p.along.abs()),
        AxialForm::PoseSign => angle(pair, options, |p| p.along.mul(pose_sign(pair))),
    })
}

/// `-sign(a_z)` at every pixel, without gradient.
fn pose_sign<'t, T: Scalar>(pair: &AlignedPair<'t, T>) -> Var<'t, T> {
    let a = pair.translation.value();
    let sign = Tensor::from_fn(pair.map_shape(), |n, _, _, _| if a.at(n, 2, 0, 0) > T::ZERO { -T::ONE } else { T::ONE });
    pair.constant(&sign)
}

/// Pixels at least `q_min` from the principal point with axial flow longer than `tau_flow`.
fn directed<T: Scalar>(pair: &AlignedPair<'_, T>, q_min: f64, tau_flow: f64) -> Tensor<T> {
    let (flow, radius) = (pair.axial_flow.value(), &pair.radius);
    masks::and_where(&pair.mask, |n| {
        let (u, v, radius) = (flow.plane(n, 0), flow.plane(n, 1), radius.plane(n, 0));
        move |i| {
            let (u, v, r) = (u[i].to_f64(), v[i].to_f64(), radius[i].to_f64());
            r > 0.0 && r >= q_min && u * u + v * v > tau_flow * tau_flow
        }
    })
}

fn literal<'t, T: Scalar>(pair: &AlignedPair<'t, T>) -> Angles<'t, T> {
    let mask = directed(pair, 0.0, 0.0);
    let part = |c| pair.keep(pair.axial_flow.slice(1, c, 1), &mask, 1.0);
    let (u, v) = (part(0), part(1));
    let (d_u, d_v) = (pair.constant(&pair.d_u), pair.constant(&pair.d_v));
    let sizes = length(u, v, 0.0).mul(pair.constant(&pair.radius_from(1e-12)));
    let cosine = u.mul(d_u).add(v.mul(d_v)).div(sizes);
    // Outside the mask the angle takes the constant cosine 0.5.
    Angles { angle: arccos(pair.keep(cosine, &mask, 0.5)), mask }
}

fn angle<'t, T: Scalar>(
    pair: &AlignedPair<'t, T>,
    options: &LossOptions,
    cosine: impl Fn(AxialProducts<'t, T>) -> Var<'t, T>,
) -> Angles<'t, T> {
    let mask = directed(pair, options.q_min, options.tau_flow);
    let products = pair.axial_products(&mask);
    let across = pair.keep(products.across.abs(), &mask, 0.0);
    let along = pair.keep(cosine(products), &mask, 1.0);
    Angles { angle: across.atan2(along), mask }
}

fn perpendicular<'t, T: Scalar>(pair: &AlignedPair<'t, T>, options: &LossOptions) -> (Var<'t, T>, Tensor<T>) {
    let q_min = options.q_min.max(1e-6);
    let radius = &pair.radius;
    let mask = masks::and_where(&pair.mask, |n| {
        let radius = radius.plane(n, 0);
        move |i| radius[i].to_f64() > q_min
    });
    let distance = pair.axial_products(&mask).across.div(pair.constant(&pair.radius_from(q_min)));
    (weighted_mean(pair.beyond_noise(soft_abs(distance, options.smooth_pixels)), &mask), mask)
}
