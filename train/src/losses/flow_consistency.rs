//! Cross-task consistency: mean difference of rigid and optical flow over valid pixels (DF-Net; a competitor and a warm-up, not
//! part of DiMoDE).
//!
//! `L = mean_valid (|u_rig - u_opt| + |v_rig - v_opt|) / 2`, per image, then over images.

use dimode_autodiff::{Scalar, Tensor, Var};

/// Consistency in pixels of flows `[n, 2, h, w]`; `mask` is `[n, 1, h, w]`, 0 or 1; an image without valid pixel counts 0.
///
/// # Panics
/// When shapes differ.
#[track_caller]
pub fn flow_consistency<'t, T: Scalar>(rigid: Var<'t, T>, optical: &Tensor<T>, mask: &Tensor<T>) -> Var<'t, T> {
    let difference = rigid.sub(rigid.tape().constant(optical.clone())).abs();
    difference.mean_channels().masked_mean(mask).mean()
}
