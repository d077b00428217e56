//! Optimisers, learning-rate schedules, gradient clipping.

pub mod adamw;
pub mod schedule;

use dimode_autodiff::ops::kernel;
use dimode_nets::ParamGradient;

/// Euclidean norm of all gradients together.
pub fn gradient_norm(gradients: &[ParamGradient<f32>]) -> f64 {
    gradients.iter().map(|g| kernel::sum_of_squares(g.gradient.data())).sum::<f64>().sqrt()
}

/// Factor that brings a gradient of the given norm down to `limit`; 1 when it is below, or when `limit` is 0.
pub fn clip_scale(norm: f64, limit: f64) -> f64 {
    if limit > 0.0 && norm > limit { limit / norm } else { 1.0 }
}
