//! `L_pla`: planar flows of a static scene are parallel (eq. `lp`).

use dimode_autodiff::{Scalar, Tensor, Var};
use serde::{Deserialize, Serialize};

use super::arccos::arccos;
use super::{AlignedPair, Angles, LossOptions, LossTerm};
use crate::taped::masks;
use crate::taped::smooth::{length, soft_abs};
use crate::taped::weighted::{weighted_mean, weighted_variance};

/// Forms of `L_pla`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PlanarForm {
    /// Variance of `arccos(f_u / |f|)`, rad^2, as printed. The derivative grows without bound towards horizontal flows and is
    /// taken as 0 at them.
    Literal,
    /// Variance of the same angle by `atan2(|f_v|, f_u)` over flows longer than `tau_flow`, rad^2.
    Robust,
    /// `2 (1 - |E[f / |f|]|)` over flows longer than `tau_flow`: sees mirrored and reversed flows too.
    Circular,
    /// `2 (1 - |sum f| / sum |f|)`: long flows count more, no threshold.
    Weighted,
    /// Mean distance, in pixels, of the flow from the line along the predicted direction `f o a_tan`, over
    /// pixels whose predicted flow `|f o a_tan| / z` exceeds `min_tangential_flow`, in images with
    /// `|a_tan| >= min_tangential_share |a|`.
    PerpendicularPixels,
}

/// Evaluates `L_pla`.
#[must_use]
pub fn planar<'t, T: Scalar>(pair: &AlignedPair<'t, T>, options: &LossOptions) -> LossTerm<'t, T> {
    let (per_image, mask) = match options.planar {
        PlanarForm::Literal => variance(literal(pair)),
        PlanarForm::Robust => variance(robust(pair, options.tau_flow)),
        PlanarForm::Circular => circular(pair, options.tau_flow),
        PlanarForm::Weighted => weighted(pair),
        PlanarForm::PerpendicularPixels => perpendicular(pair, options),
    };
    LossTerm::new(per_image, &mask, options.min_valid_share)
}

/// Value an image (N,1,1,1) and the mask it was taken over.
type Masked<'t, T> = (Var<'t, T>, Tensor<T>);

/// Pixels of the pair's mask with planar flow longer than `shortest`.
fn longer_than<T: Scalar>(pair: &AlignedPair<'_, T>, shortest: f64) -> Tensor<T> {
    let flow = pair.planar_flow.value();
    masks::and_where(&pair.mask, |n| {
        let (u, v) = (flow.plane(n, 0), flow.plane(n, 1));
        move |i| {
            let (u, v) = (u[i].to_f64(), v[i].to_f64());
            u * u + v * v > shortest * shortest
        }
    })
}

/// Planar flow with a harmless constant outside the mask.
fn components<'t, T: Scalar>(pair: &AlignedPair<'t, T>, mask: &Tensor<T>) -> (Var<'t, T>, Var<'t, T>) {
    let part = |c, filler| pair.keep(pair.planar_flow.slice(1, c, 1), mask, filler);
    (part(0, 1.0), part(1, 1.0))
}

fn literal<'t, T: Scalar>(pair: &AlignedPair<'t, T>) -> Angles<'t, T> {
    let mask = longer_than(pair, 0.0);
    let (u, v) = components(pair, &mask);
    Angles { angle: arccos(u.div(length(u, v, 0.0))), mask }
}

fn robust<'t, T: Scalar>(pair: &AlignedPair<'t, T>, tau_flow: f64) -> Angles<'t, T> {
    let mask = longer_than(pair, tau_flow);
    let (u, v) = components(pair, &mask);
    Angles { angle: v.abs().atan2(u), mask }
}

/// The angles whose variance `L_pla` is, in the form that the options ask for; `None` for the forms without angles.
#[must_use]
pub fn planar_angles<'t, T: Scalar>(pair: &AlignedPair<'t, T>, options: &LossOptions) -> Option<Angles<'t, T>> {
    match options.planar {
        PlanarForm::Literal => Some(literal(pair)),
        PlanarForm::Robust => Some(robust(pair, options.tau_flow)),
        _ => None,
    }
}

fn variance<'t, T: Scalar>(Angles { angle, mask }: Angles<'t, T>) -> Masked<'t, T> {
    (weighted_variance(angle, &mask), mask)
}

/// `2 (1 - |(x, y)|)` of per-image mean directions.
fn spread_of<'t, T: Scalar>(x: Var<'t, T>, y: Var<'t, T>) -> Var<'t, T> {
    length(x, y, 0.0).neg().add_scalar(1.0).scale(2.0)
}

fn circular<'t, T: Scalar>(pair: &AlignedPair<'t, T>, tau_flow: f64) -> Masked<'t, T> {
    let mask = longer_than(pair, tau_flow);
    let (u, v) = components(pair, &mask);
    let size = length(u, v, 0.0);
    let mean = |f: Var<'t, T>| weighted_mean(f.div(size), &mask);
    (spread_of(mean(u), mean(v)), mask)
}

fn weighted<'t, T: Scalar>(pair: &AlignedPair<'t, T>) -> Masked<'t, T> {
    let mask = longer_than(pair, 0.0);
    let (u, v) = components(pair, &mask);
    let total = weighted_mean(length(u, v, 0.0), &mask);
    let mean = |f: Var<'t, T>| weighted_mean(f, &mask).div_guarded(total, 1e-12);
    (spread_of(mean(u), mean(v)), mask)
}

fn perpendicular<'t, T: Scalar>(pair: &AlignedPair<'t, T>, options: &LossOptions) -> Masked<'t, T> {
    let x = pair.constant(&pair.focal_u).mul(pair.a(0));
    let y = pair.constant(&pair.focal_v).mul(pair.a(1));
    let size = length(x, y, 0.0);
    let (depth, sizes, translation) = (pair.target_depth.value(), size.value(), pair.translation.value());
    let tangential = |n: usize| {
        let [x, y, z] = [0, 1, 2].map(|c| translation.at(n, c, 0, 0).to_f64());
        x.hypot(y) >= options.min_tangential_share * x.hypot(y).hypot(z)
    };
    let usable: Vec<bool> = (0..sizes.shape().n()).map(tangential).collect();
    let mask = masks::and_where(&pair.mask, |n| {
        let (usable, size, depth) = (usable[n], sizes.at(n, 0, 0, 0).to_f64(), depth.plane(n, 0));
        move |i| usable && size > options.min_tangential_flow * depth[i].to_f64()
    });
    let direction = |c: Var<'t, T>| {
        let c = c.div_guarded(size, 1e-12);
        pair.spread(if options.detach_direction { c.detach() } else { c })
    };
    let (u, v) = components(pair, &mask);
    let distance = u.mul(direction(y)).sub(v.mul(direction(x)));
    (weighted_mean(pair.beyond_noise(soft_abs(distance, options.smooth_pixels)), &mask), mask)
}
