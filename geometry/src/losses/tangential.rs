//! `L_tan`: planar flow, depth and tangential translation agree (eq. `lt`).

use dimode_autodiff::{Scalar, Tensor, Var};
use serde::{Deserialize, Serialize};

use super::ratio_term::{Ratio, RatioTerm};
use super::{AlignedPair, LossOptions, LossTerm};
use crate::taped::masks;
use crate::taped::smooth::length;
use crate::taped::weighted::weighted_mean;

/// Forms of `L_tan`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TangentialForm {
    /// `A_x + C_x + A_y + C_y` as printed: unbounded where a flow or translation component is near zero.
    /// A component of exactly 0 has no `C`.
    Literal,
    /// The same with small flow components dropped, outliers gated and the denominators of `C` bounded below.
    Robust,
    /// `sum_k E[|z / rho_k - a_k|] / |a|` with `z / rho_x = z f_u / fu`: linear in the flow.
    InverseRatio,
    /// The same equation in the image: `E[|f_pla - (f o a_tan) / z|]`, pixels.
    FlowPixels,
}

/// Evaluates `L_tan`.
#[must_use]
pub fn tangential<'t, T: Scalar>(pair: &AlignedPair<'t, T>, options: &LossOptions) -> LossTerm<'t, T> {
    let mask = with_target_depth(pair, options.z_min);
    let per_image = match options.tangential {
        TangentialForm::Literal => sum_of_axes(pair, options, |k| axis_ratio(pair, &mask, k, None).sum()),
        TangentialForm::Robust => sum_of_axes(pair, options, |k| axis_ratio(pair, &mask, k, Some(options)).sum()),
        TangentialForm::InverseRatio => inverse_ratio(pair, &mask, options),
        TangentialForm::FlowPixels => flow_pixels(pair, &mask, options.smooth_pixels),
    };
    LossTerm::new(per_image, &mask, options.min_valid_share)
}

/// The pair's mask where the target depth is in front of the camera.
pub(super) fn with_target_depth<T: Scalar>(pair: &AlignedPair<'_, T>, z_min: f64) -> Tensor<T> {
    let z = pair.target_depth.value();
    let z_min = T::from_f64(z_min);
    masks::and_where(&pair.mask, |n| {
        let z = z.plane(n, 0);
        move |i| z[i] > z_min && z[i].is_finite()
    })
}

/// The sum over those of x and y that count, (N,1,1,1).
fn sum_of_axes<'t, T: Scalar>(
    pair: &AlignedPair<'t, T>,
    options: &LossOptions,
    term: impl Fn(usize) -> Var<'t, T>,
) -> Var<'t, T> {
    let counted = (0..2).filter(|&k| options.axes[k]).map(term);
    counted.reduce(|a, b| a.add(b)).unwrap_or_else(|| pair.constant(&Tensor::zeros(pair.a(0).shape())))
}

fn focal<'t, T: Scalar>(pair: &AlignedPair<'t, T>, k: usize) -> Var<'t, T> {
    pair.constant(if k == 0 { &pair.focal_u } else { &pair.focal_v })
}

/// `z / rho_k = z f_k / focal_k`, 0 outside the mask.
fn recovered<'t, T: Scalar>(pair: &AlignedPair<'t, T>, mask: &Tensor<T>, k: usize) -> Var<'t, T> {
    let flow = pair.keep(pair.planar_flow.slice(1, k, 1), mask, 0.0);
    pair.keep(pair.target_depth, mask, 1.0).mul(flow).div(pair.spread(focal(pair, k)))
}

/// The printed terms along axis `k`; thresholds only with options.
pub(super) fn axis_ratio<'t, T: Scalar>(
    pair: &AlignedPair<'t, T>,
    mask: &Tensor<T>,
    k: usize,
    robust: Option<&LossOptions>,
) -> RatioTerm<'t, T> {
    let smallest = robust.map_or(0.0, |o| o.tau_ratio);
    let flows = pair.planar_flow.value();
    let divisible = masks::and_where(mask, |n| {
        let flow = flows.plane(n, k);
        move |i| flow[i].to_f64().abs() > smallest
    });
    let flow = pair.keep(pair.planar_flow.slice(1, k, 1), &divisible, 1.0);
    let ratio = pair.spread(focal(pair, k)).div(flow);
    RatioTerm::new(pair, Ratio { ratio, divisible, inverse: recovered(pair, mask, k), mask: mask.clone() }, k, robust)
}

/// `|a|`, (N,1,1,1).
pub(super) fn translation_length<'t, T: Scalar>(pair: &AlignedPair<'t, T>) -> Var<'t, T> {
    length(length(pair.a(0), pair.a(1), 0.0), pair.a(2), 0.0)
}

fn inverse_ratio<'t, T: Scalar>(pair: &AlignedPair<'t, T>, mask: &Tensor<T>, options: &LossOptions) -> Var<'t, T> {
    let residual = |k| weighted_mean(recovered(pair, mask, k).sub(pair.spread(pair.a(k))).abs(), mask);
    sum_of_axes(pair, options, residual).div_guarded(translation_length(pair), 1e-9)
}

fn flow_pixels<'t, T: Scalar>(pair: &AlignedPair<'t, T>, mask: &Tensor<T>, smooth: f64) -> Var<'t, T> {
    let z = pair.keep(pair.target_depth, mask, 1.0);
    let residual = |k: usize| {
        let predicted = pair.spread(focal(pair, k).mul(pair.a(k))).div(z);
        pair.keep(pair.planar_flow.slice(1, k, 1), mask, 0.0).sub(predicted)
    };
    weighted_mean(pair.beyond_noise(length(residual(0), residual(1), smooth)), mask)
}
