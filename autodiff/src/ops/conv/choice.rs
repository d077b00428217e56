//! Which kernel for which convolution.
//!
//! Billions of operations a second on one thread of a Xeon with AVX-512 whose peak is 220, whole passes with all copies, best of
//! several; forward / gradient of the input / gradient of the weights. What stands under "instead" was measured with trial programs
//! and is not in the tree:
//!
//! | shape | taken | instead |
//! |---|---|---|
//! | 1x1 64-256, 24x80 | product 146 / 135 / 133 | direct 102 / 62 / 45 |
//! | depth-wise 3x3 64, 48x160, any dilation | plane by plane 36 / 34 / 33 | direct 21 / 17 / 16 |
//! | 3x3 64-64, 48x160 | direct 131 / 128 / 139 | product alone, no column matrix made: 78, in tiles of 256 pixels 153 |
//! | 3x3 128-128, 24x80 | direct 139 / 132 / 149 | product alone 124 |
//! | 3x3 256-256, 12x40 | direct 136 / 131 / 126 | product alone 145 |
//! | 3x3 512-512, 6x20 | direct 131 / 106 / 78 | product alone 134 |
//! | 3x3 16-16, 192x640 | direct 106 / 108 / 74 | strips of outputs for the weights 52; product alone 91 |
//! | 3x3 32-16, 96x320 | direct 116 / 119 / 86 | |
//!
//! A column matrix has nine times the size of the image and must be written and read besides, so a product pays only where the
//! input is its column matrix already. In the direct gradient of the weights, more than 16 outputs go in strips, where 2 x 10
//! registers reach 155 alone; up to 16 go by planes, which have nothing to transpose but reach 105.

use super::layout::Layout;

/// Ways to convolve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Algorithm {
    /// One matrix product in place: one tap, no padding, stride 1, one group.
    Pointwise,
    /// Plane by plane: no channels are mixed, stride 1.
    Depthwise,
    /// 16 products for four outputs: 3 x 3, stride 1, no dilation, one group, many channels.
    Winograd,
    /// Shifted planes times broadcast weights: everything else.
    Direct,
}

/// The fastest way for a shape.
pub fn algorithm(l: &Layout) -> Algorithm {
    // Products of few rows or columns leave most of a register block empty.
    const FEW: usize = 8;
    if l.groups == 1 && l.taps == 1 && l.is_dense() && l.padding() == (0, 0) && l.cin.min(l.cout) >= FEW {
        Algorithm::Pointwise
    } else if l.cin == 1 && l.cout == 1 && l.is_dense() {
        Algorithm::Depthwise
    } else if pays_winograd(l) {
        Algorithm::Winograd
    } else {
        Algorithm::Direct
    }
}

/// Whether Winograd's scheme fits and is faster.
fn pays_winograd(l: &Layout) -> bool {
    // With fewer channels, tiles cost more than they save.
    let channels = l.cin.min(l.cout) >= 16 && l.cin * l.cout >= 512;
    // With fewer tiles, the weights do.
    let tiles = l.output.n() * l.output.h().div_ceil(2) * l.output.w().div_ceil(2);
    l.is_winograd() && channels && tiles >= 64
}
