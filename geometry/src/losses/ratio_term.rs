//! What `L_tan` and `L_rad` add up along one axis: the error of the ratio at every pixel and of the translation recovered from all.

use dimode_autodiff::{Scalar, Tensor, Var};

use super::{AlignedPair, LossOptions, RadialForm, TangentialForm, radial, tangential};
use crate::taped::masks;
use crate::taped::weighted::weighted_mean;

/// The printed terms of one axis, with the pixels behind them.
#[derive(Clone, Debug)]
pub struct RatioTerm<'t, T: Scalar> {
    /// `rho = z / a`, as the aligned flow says, (N,1,H,W); finite but meaningless where the flow cannot be divided by.
    pub ratio: Var<'t, T>,
    /// Pixels of [`RatioTerm::pixel_error`], (N,1,H,W): flow large enough and error below the gate.
    pub pixels: Tensor<T>,
    /// `A = E[|rho a - z| / z]`, (N,1,1,1).
    pub pixel_error: Var<'t, T>,
    /// `E[z / rho]`, the recovered component of the translation, (N,1,1,1).
    pub recovered: Var<'t, T>,
    /// `C = |(E[z / rho] - a) / a|`; in the robust form over `max(|a_k|, tau_translation, kappa |a|)`, (N,1,1,1).
    pub aggregate_error: Var<'t, T>,
    /// Pixels of [`RatioTerm::recovered`], (N,1,H,W).
    pub mask: Tensor<T>,
}

/// The terms along axis 0, 1 (`L_tan`) or 2 (`L_rad`): without thresholds when the options ask for the literal form of that loss,
/// else with those of the robust form.
///
/// **Panics** for another axis.
#[must_use]
#[track_caller]
pub fn ratio_term<'t, T: Scalar>(pair: &AlignedPair<'t, T>, options: &LossOptions, axis: usize) -> RatioTerm<'t, T> {
    assert!(axis < 3, "ratio_term: axis {axis}; the rule: 0, 1 or 2");
    let base = tangential::with_target_depth(pair, options.z_min);
    if axis < 2 {
        let robust = (options.tangential != TangentialForm::Literal).then_some(options);
        tangential::axis_ratio(pair, &base, axis, robust)
    } else {
        radial::axis_ratio(pair, &base, (options.radial != RadialForm::Literal).then_some(options))
    }
}

/// A ratio with the pixels that have one, and `z / rho` at every pixel with those where it can be recovered.
pub(super) struct Ratio<'t, T: Scalar> {
    pub ratio: Var<'t, T>,
    pub divisible: Tensor<T>,
    pub inverse: Var<'t, T>,
    pub mask: Tensor<T>,
}

impl<'t, T: Scalar> RatioTerm<'t, T> {
    /// Takes the means along an axis; thresholds only with options.
    pub(super) fn new(pair: &AlignedPair<'t, T>, of: Ratio<'t, T>, axis: usize, robust: Option<&LossOptions>) -> Self {
        let a = pair.a(axis);
        let (pixel_error, pixels) = pixel_error(pair, of.ratio.mul(pair.spread(a)), &of.divisible, robust.map(|o| o.gate));
        let recovered = weighted_mean(of.inverse, &of.mask);
        let difference = recovered.sub(a);
        let aggregate_error = match robust {
            None => difference.div(a).abs(),
            Some(options) => difference.abs().div(a.abs().maximum(smallest_divisor(pair, options))),
        };
        Self { ratio: of.ratio, pixels, pixel_error, recovered, aggregate_error, mask: of.mask }
    }

    /// `A + C`, (N,1,1,1).
    #[must_use]
    pub fn sum(&self) -> Var<'t, T> {
        self.pixel_error.add(self.aggregate_error)
    }
}

/// `E[|rho a - z| / z]` from `rho a`, over errors below the gate, and the pixels it is taken over.
fn pixel_error<'t, T: Scalar>(
    pair: &AlignedPair<'t, T>,
    scaled_ratio: Var<'t, T>,
    mask: &Tensor<T>,
    gate: Option<f64>,
) -> (Var<'t, T>, Tensor<T>) {
    let z = pair.keep(pair.target_depth, mask, 1.0);
    let error = pair.keep(scaled_ratio, mask, 1.0).sub(z).abs().div(z);
    let values = error.value();
    let kept = masks::and_where(mask, |n| {
        let errors = values.plane(n, 0);
        move |i| gate.is_none_or(|gate| errors[i].to_f64() < gate)
    });
    (weighted_mean(error, &kept), kept)
}

/// `max(tau_translation, kappa |a|)` of every sample, without gradient.
fn smallest_divisor<'t, T: Scalar>(pair: &AlignedPair<'t, T>, options: &LossOptions) -> Var<'t, T> {
    let values = pair.translation.value();
    pair.constant(&Tensor::from_fn(pair.a(0).shape(), |n, _, _, _| {
        let norm = (0..3).map(|i| values.at(n, i, 0, 0).to_f64().powi(2)).sum::<f64>().sqrt();
        T::from_f64(options.tau_translation.max(options.kappa * norm))
    }))
}
