//! Relative errors that count only below a gate, as DCPI-Depth averages them.

use dimode_autodiff::{Scalar, Tensor, Var};

use super::masked::batch_mean;

/// Keeps denominators away from 0 where they are positive; where they are not, the gate does.
pub(super) const GUARD: f64 = 1e-5;

/// A mean over what passed a gate.
#[derive(Clone, Debug)]
pub struct Gated<'t, T: Scalar> {
    /// Mean over the kept entries of the batch, 0 without any.
    pub mean: Var<'t, T>,
    /// The error of every entry, infinite or NaN where a denominator is 0.
    pub errors: Tensor<T>,
    /// 1 where the error is below the gate.
    pub kept: Tensor<T>,
}

/// `|difference / size|` over the entries of `mask`, gated.
pub(super) fn relative<'t, T: Scalar>(
    difference: Var<'t, T>,
    size: Var<'t, T>,
    mask: Option<&Tensor<T>>,
    gate: f64,
) -> Gated<'t, T> {
    let shape = size.shape();
    let mut errors: Vec<T> = difference.value().data().iter().zip(size.value().data()).map(|(&d, &s)| (d / s).abs()).collect();
    if let Some(mask) = mask {
        let left_out = |(e, &m): (&mut T, &T)| {
            if m == T::ZERO {
                *e = T::from_f64(f64::INFINITY)
            }
        };
        errors.iter_mut().zip(mask.data()).for_each(left_out);
    }
    let errors = Tensor::from_vec(shape, errors);
    let kept = below(&errors, gate);
    let one = size.tape().constant(Tensor::full(shape, T::ONE));
    let error = difference.select(&kept, one).div(size.select(&kept, one)).abs();
    Gated { mean: batch_mean(error, &kept, 0), errors, kept }
}

/// 1 where an error is below the gate (NaN is not).
pub(super) fn below<T: Scalar>(errors: &Tensor<T>, gate: f64) -> Tensor<T> {
    let gate = T::from_f64(gate);
    Tensor::from_vec(errors.shape(), errors.data().iter().map(|&e| if e < gate { T::ONE } else { T::ZERO }).collect())
}
