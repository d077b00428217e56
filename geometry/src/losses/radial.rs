//! `L_rad`: axial flow, depth and radial translation agree (eq. `lr`).

use dimode_autodiff::{Scalar, Tensor, Var};
use serde::{Deserialize, Serialize};

use super::ratio_term::{Ratio, RatioTerm};
use super::tangential::{translation_length, with_target_depth};
use super::{AlignedPair, LossOptions, LossTerm};
use crate::taped::masks;
use crate::taped::smooth::soft_abs;
use crate::taped::weighted::weighted_mean;

/// Forms of `L_rad`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RadialForm {
    /// `A_z + C_z` as printed: unbounded where the radial flow is near zero.
    /// A component of exactly 0 has no `C`.
    Literal,
    /// The same with small radial flows dropped, outliers gated and the denominator of `C` bounded below.
    Robust,
    /// `E[|z / rho_z - a_z|] / |a|` with `z / rho_z = -z (d . f) / (d . (f + d))`.
    InverseRatio,
    /// The same equation in the image, along the radius: `E[|d . f / |d| + |d| a_z / (z + a_z)|]`, pixels.
    FlowPixels,
}

/// Evaluates `L_rad`.
#[must_use]
pub fn radial<'t, T: Scalar>(pair: &AlignedPair<'t, T>, options: &LossOptions) -> LossTerm<'t, T> {
    let base = with_target_depth(pair, options.z_min);
    let (per_image, mask) = match options.radial {
        RadialForm::FlowPixels => flow_pixels(pair, &base, options),
        _ if !options.axes[2] => nothing(pair),
        RadialForm::Literal => printed(axis_ratio(pair, &base, None)),
        RadialForm::Robust => printed(axis_ratio(pair, &base, Some(options))),
        RadialForm::InverseRatio => inverse_ratio(pair, &base, options),
    };
    LossTerm::new(per_image, &mask, options.min_valid_share)
}

/// 0 of no pixel.
fn nothing<'t, T: Scalar>(pair: &AlignedPair<'t, T>) -> (Var<'t, T>, Tensor<T>) {
    (pair.constant(&Tensor::zeros(pair.a(2).shape())), Tensor::zeros(pair.mask.shape()))
}

/// `A + C` and the pixels of `C`.
fn printed<T: Scalar>(term: RatioTerm<'_, T>) -> (Var<'_, T>, Tensor<T>) {
    (term.sum(), term.mask)
}

/// Radial flow `d . f / |d|` (0 at the principal point) of every pixel, from values.
fn radial_flow<T: Scalar>(pair: &AlignedPair<'_, T>) -> Tensor<T> {
    let flow = pair.axial_flow.value();
    let mut out = vec![T::ZERO; pair.radius.shape().len()];
    let plane = pair.radius.shape().plane();
    for (n, out) in out.chunks_exact_mut(plane).enumerate() {
        let (x, y, r) = (pair.d_u.plane(n, 0), pair.d_v.plane(n, 0), pair.radius.plane(n, 0));
        let (u, v) = (flow.plane(n, 0), flow.plane(n, 1));
        for (i, out) in out.iter_mut().enumerate() {
            if r[i] > T::ZERO {
                *out = (x[i] * u[i] + y[i] * v[i]) / r[i];
            }
        }
    }
    Tensor::from_vec(pair.radius.shape(), out)
}

/// Pixels off the principal point where the flow does not end on it: `d . (f + d) / |d| > smallest`.
fn recoverable<T: Scalar>(pair: &AlignedPair<'_, T>, base: &Tensor<T>, q_min: f64, smallest: f64) -> Tensor<T> {
    let (along, radius) = (radial_flow(pair), &pair.radius);
    masks::and_where(base, |n| {
        let (along, radius) = (along.plane(n, 0), radius.plane(n, 0));
        move |i| {
            let r = radius[i].to_f64();
            r > 0.0 && r >= q_min && along[i].to_f64() + r > smallest
        }
    })
}

/// Pixels off the principal point, but for those whose flow ends on it to the last bit: nothing can be recovered there.
fn off_the_principal_point<T: Scalar>(pair: &AlignedPair<'_, T>, base: &Tensor<T>) -> Tensor<T> {
    let (flow, d_u, d_v) = (pair.axial_flow.value(), &pair.d_u, &pair.d_v);
    masks::and_where(base, |n| {
        let (x, y) = (d_u.plane(n, 0), d_v.plane(n, 0));
        let (u, v) = (flow.plane(n, 0), flow.plane(n, 1));
        move |i| {
            let squares = x[i] * x[i] + y[i] * y[i];
            squares > T::ZERO && x[i] * u[i] + y[i] * v[i] + squares != T::ZERO
        }
    })
}

fn radius_squared<'t, T: Scalar>(pair: &AlignedPair<'t, T>) -> Var<'t, T> {
    pair.constant(&pair.d_u).square().add(pair.constant(&pair.d_v).square())
}

/// `z / rho_z = -z (d . f) / (d . f + |d|^2)`; 0 outside the mask.
fn recovered<'t, T: Scalar>(pair: &AlignedPair<'t, T>, mask: &Tensor<T>) -> Var<'t, T> {
    let along = pair.keep(pair.axial_products(mask).along, mask, 0.0);
    let whole = pair.keep(along.add(radius_squared(pair)), mask, 1.0);
    pair.keep(pair.target_depth, mask, 1.0).mul(along).div(whole).neg()
}

/// The printed terms along the axis; thresholds only with options.
pub(super) fn axis_ratio<'t, T: Scalar>(
    pair: &AlignedPair<'t, T>,
    base: &Tensor<T>,
    robust: Option<&LossOptions>,
) -> RatioTerm<'t, T> {
    let (q_min, smallest) = robust.map_or((0.0, 0.0), |o| (o.q_min, o.tau_ratio));
    let (flow, radius) = (radial_flow(pair), &pair.radius);
    let divisible = masks::and_where(base, |n| {
        let (flow, radius) = (flow.plane(n, 0), radius.plane(n, 0));
        move |i| {
            let r = radius[i].to_f64();
            r > 0.0 && r >= q_min && flow[i].to_f64().abs() > smallest
        }
    });
    let along = pair.keep(pair.axial_products(&divisible).along, &divisible, 1.0);
    let ratio = along.add(radius_squared(pair)).div(along).neg();
    let mask = match robust {
        Some(o) => recoverable(pair, base, o.q_min, o.tau_ratio),
        None => off_the_principal_point(pair, base),
    };
    RatioTerm::new(pair, Ratio { ratio, divisible, inverse: recovered(pair, &mask), mask }, 2, robust)
}

fn inverse_ratio<'t, T: Scalar>(pair: &AlignedPair<'t, T>, base: &Tensor<T>, options: &LossOptions) -> (Var<'t, T>, Tensor<T>) {
    let mask = recoverable(pair, base, options.q_min, options.tau_ratio);
    let residual = weighted_mean(recovered(pair, &mask).sub(pair.spread(pair.a(2))).abs(), &mask);
    (residual.div_guarded(translation_length(pair), 1e-9), mask)
}

fn flow_pixels<'t, T: Scalar>(pair: &AlignedPair<'t, T>, base: &Tensor<T>, options: &LossOptions) -> (Var<'t, T>, Tensor<T>) {
    let (z, a, radius) = (pair.target_depth.value(), pair.translation.value(), &pair.radius);
    let q_min = options.q_min.max(1e-6);
    let mask = masks::and_where(base, |n| {
        let (z, radius, a_z) = (z.plane(n, 0), radius.plane(n, 0), a.at(n, 2, 0, 0).to_f64());
        move |i| radius[i].to_f64() >= q_min && z[i].to_f64() + a_z > options.z_min
    });
    let a_z = pair.spread(pair.a(2));
    let source_depth = pair.keep(pair.target_depth.add(a_z), &mask, 1.0);
    let radius = pair.constant(&pair.radius_from(q_min));
    let along = pair.axial_products(&mask).along.div(radius);
    let residual = along.add(radius.mul(a_z).div(source_depth));
    (weighted_mean(pair.beyond_noise(soft_abs(residual, options.smooth_pixels)), &mask), mask)
}
