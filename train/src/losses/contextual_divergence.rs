//! `L_dpc` of DCPI-Depth: the divergence of the flow goes with the slope of the depth. See [`divergence_agreement`].

use dimode_autodiff::ops::pad::Sides;
use dimode_autodiff::{Scalar, Shape, Tensor, Var};

use super::contextual_geometric::{ContextualForm, ContextualInputs, dot};
use super::gated::{GUARD, Gated, relative};

/// Relative errors of divergences from here on do not count.
pub const DIVERGENCE_GATE: f64 = 0.2;

/// Signs and depth in [`divergence_agreement`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DivergenceForm {
    /// As follows from the flow of a translation along the axis, over inner pixels.
    #[default]
    Corrected,
    /// As the public code: `D` for the source depth, the opposite sign of the gradient's term, and borders that see zeros. At the
    /// truth its error is 2 or, unless the translation is small beside the depth, anything: neither counts but by accident. For
    /// comparison only.
    AsCoded,
}

/// `L_dpc`: the divergence of the translational flow must go with the slope of the depth.
///
/// For a translation along the axis `f = -q t_z / D_s` with the source depth `D_s = D + t_z`, so
/// `div f D_s / t' = 2 - (q . grad D) / D_s` with `t' = -t_z`. With central differences that are not divided by two,
/// `a = div D_s / t' - 4` and `b = -(q . grad) / D_s` must be equal; the loss is the mean of `|a - b| / |b + 1e-5|` below 0.2.
/// DCPI-Depth adds it in the last third of training. Differences neglect third derivatives of the flow.
///
/// **Gradient**: to flow, depth and `t_z`.
///
/// # Panics
/// When shapes differ or a side is shorter than 3 pixels.
#[track_caller]
pub fn divergence_agreement<'t, T: Scalar>(
    inputs: &ContextualInputs<'_, 't, T>,
    centre: ContextualForm,
    form: DivergenceForm,
) -> Gated<'t, T> {
    let (inputs, finite) = inputs.without_holes();
    let (q, f) = (inputs.offsets(centre), inputs.translational_flow(centre));
    let backward = inputs.translation(2).neg();
    let scale = match form {
        DivergenceForm::Corrected => inputs.depth.sub(backward),
        DivergenceForm::AsCoded => inputs.depth,
    };
    let inner = match form {
        DivergenceForm::Corrected => inner_pixels(inputs.shape()),
        DivergenceForm::AsCoded => Tensor::full(inputs.shape(), T::ONE),
    };
    let usable = usable(&surrounded(&inner, &finite), &scale.value(), &backward.value());
    let one = inputs.constant(Tensor::full(inputs.shape(), T::ONE));
    let (scale, backward) = (scale.select(&usable, one), backward.select(&usable, one));
    let divergence = central(f.slice(1, 0, 1), 3).add(central(f.slice(1, 1, 1), 2));
    let slope = Var::concat(&[central(inputs.depth, 3), central(inputs.depth, 2)], 1);
    let a = divergence.mul(scale).div(backward).add_scalar(-4.0);
    let b = dot(slope, q).div(scale);
    let b = if form == DivergenceForm::Corrected { b.neg() } else { b };
    relative(a.sub(b), b.add_scalar(GUARD), Some(&usable), DIVERGENCE_GATE)
}

/// `x(i + 1) - x(i - 1)` along rows (axis 2) or columns (3), with 0 outside.
fn central<T: Scalar>(x: Var<'_, T>, axis: usize) -> Var<'_, T> {
    let size = x.shape().0[axis];
    let sides =
        if axis == 2 { Sides { top: 1, bottom: 1, ..Sides::default() } } else { Sides { left: 1, right: 1, ..Sides::default() } };
    let padded = x.pad_zero(sides);
    padded.slice(axis, 2, size).sub(padded.slice(axis, 0, size))
}

/// 1 but for a frame of one pixel.
fn inner_pixels<T: Scalar>(shape: Shape) -> Tensor<T> {
    super::census::framed(&Tensor::full(shape, T::ONE), 1)
}

/// Pixels of a mask that are in another with the neighbours that differences take.
fn surrounded<T: Scalar>(mask: &Tensor<T>, by: &Tensor<T>) -> Tensor<T> {
    let s = mask.shape();
    let around = |n: usize, h: usize, w: usize| {
        let rows = h.saturating_sub(1)..(h + 2).min(s.h());
        let columns = w.saturating_sub(1)..(w + 2).min(s.w());
        rows.map(|h| by.at(n, 0, h, w)).chain(columns.map(|w| by.at(n, 0, h, w))).all(|m| m != T::ZERO)
    };
    Tensor::from_fn(s, |n, c, h, w| if around(n, h, w) { mask.at(n, c, h, w) } else { T::ZERO })
}

/// Pixels of a mask where both numbers can be divided by.
fn usable<T: Scalar>(mask: &Tensor<T>, scale: &Tensor<T>, backward: &Tensor<T>) -> Tensor<T> {
    let tiny = T::from_f64(1e-9);
    let keep = |((&m, &d), &t): ((&T, &T), &T)| if m != T::ZERO && d > tiny && t.abs() > tiny { T::ONE } else { T::ZERO };
    Tensor::from_vec(mask.shape(), mask.data().iter().zip(scale.data()).zip(backward.data()).map(keep).collect())
}

#[cfg(test)]
mod tests {
    use super::super::contextual_geometric::tests::{exact, motion};
    use super::*;

    #[test]
    fn divergence_and_slope_agree_at_the_truth_but_not_as_coded() {
        exact(motion([0.0; 3], [0.0, 0.0, -0.02]), |inputs| {
            let errors = |form| divergence_agreement(inputs, ContextualForm::Corrected, form).errors;
            let inner = inner_pixels::<f64>(inputs.shape());
            let [good, coded] = [DivergenceForm::Corrected, DivergenceForm::AsCoded].map(|form| {
                let errors = errors(form);
                let mut inside: Vec<f64> =
                    errors.data().iter().zip(inner.data()).filter(|(_, m)| **m != 0.0).map(|(e, _)| *e).collect();
                inside.sort_by(f64::total_cmp);
                inside[inside.len() / 2]
            });
            assert!(good < 0.05, "{good}");
            assert!((coded - 2.0).abs() < 0.5, "{coded}");
            let gated = divergence_agreement(inputs, ContextualForm::Corrected, DivergenceForm::Corrected);
            assert!(gated.kept.data().iter().sum::<f64>() > 0.6 * 160.0);
        });
    }
}
