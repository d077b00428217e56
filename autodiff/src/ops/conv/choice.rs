//! Which kernel for which convolution.
//!
//! Billions of operations a second on one thread of a Xeon with AVX-512 whose peak is 220, whole passes with all copies, best of
//! several; forward / gradient of the input / gradient of the weights. Winograd's scheme counts as many operations as the
//! definition. What stands under "instead" is another way of the tree, or was measured with trial programs where it says alone:
//!
//! | shape | taken | instead |
//! |---|---|---|
//! | 1x1 64-256, 24x80 | product 146 / 135 / 133 | direct 102 / 62 / 45 |
//! | depth-wise 3x3 64, 48x160, any dilation | plane by plane 36 / 34 / 33 | direct 21 / 17 / 16 |
//! | 3x3 64-64, 48x160 | Winograd 216 / 215 / 190 | direct 132 / 126, strips 139; product alone 153 |
//! | 3x3 128-128, 24x80 | Winograd 232 / 245 / 212 | direct 137 / 132, strips 146; product alone 124 |
//! | 3x3 256-256, 12x40 | Winograd 186 / 197 / 185 | direct 135 / 127, strips 135; product alone 145 |
//! | 3x3 512-512, 6x20 | Winograd 131 / 115 / 120 | direct 126 / 114, strips 85; product alone 134 |
//! | 3x3 512-512, 6x20, 2 images | Winograd 154 / 128 / 131 | direct 118 / 103 |
//! | 3x3 256-256, 6x20, 4 images | Winograd 193 / 189 / 150 | direct 126 / 111 |
//! | 3x3 16-16, 192x640 | direct 124 / 113, strips 104 | Winograd 99 / 84 / 104; planes for the weights 80 |
//! | 3x3 32-16, 96x320 | Winograd 133 / 143 / 132 | direct 121 / 117, strips 120; planes for the weights 84 |
//! | 3x3 stride 2 64-128, 48x160 | Winograd 147 / 120, strips 127 | direct 131 / 92 |
//! | 3x3 stride 2 128-256, 24x80 | Winograd 136 / 104, strips 124 | direct 129 / 91 |
//! | 3x3 stride 2 256-512, 12x40 | direct 125 / 66, strips 86 | Winograd 107 / 64 |
//! | 3x3 stride 2 32-64, 16x48, 4 images | direct 102 / 75, strips 104 | Winograd 102 / 74 |
//! | 3x3 stride 2 16-32, 32x96, 4 images | direct 98 / 65, strips 87 | Winograd 65 / 64 |
//! | 7x7 stride 2 3-64, 192x640 | direct 145 / 55, strips 104 | |
//! | 3x3 128-128, 2x6, 4 images | columns 94 / 98 | direct 64 / 45 |
//! | 3x3 64-64, 4x12, 4 images | columns 105 / 106 | direct 97 / 96 |
//! | 3x3 stride 2 64-128, 4x12, 4 images | columns 72 / 35 | direct 53 / 30 |
//! | 3x3 stride 2 32-64, 8x24, 4 images | columns 78, direct 52 | direct 70, columns 44 |
//! | 3x3 128-128, 4x12 | columns 115 / 118 | Winograd 63 / 64 |
//!
//! A column matrix has nine times the size of the image and must be written and read besides: even in the second-level cache it
//! pays only where rows are so short that they leave most of the direct product's registers empty, or where the input is its
//! column matrix already. Winograd's transforms of the weights pay only over many tiles, those of the tiles only over many
//! channels; with stride 2, where they save a third and not a half, over more of both. In the gradient of the weights it is the transform of the sums that few tiles pay for, and it costs less than the
//! copies of the direct way: a map of one tile is twice as fast. What counts there is that strips of 16 channels are full: 24-24 and
//! 20-64 gain nothing, 17-17 loses a third. In the direct gradient of the weights, more than 8 outputs go in strips, whose products
//! reach 140 to 160 alone; up to 8 go by planes, which have nothing to transpose but reach 105.

use super::layout::Layout;
use super::winograd_weight_kernels::STRIP;

/// Ways to convolve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Algorithm {
    /// One matrix product in place: one tap, no padding, stride 1, one group.
    Pointwise,
    /// Plane by plane: no channels are mixed, stride 1.
    Depthwise,
    /// 16 products for four outputs, 25 with stride 2: 3 x 3, no dilation, one group, many channels.
    Winograd,
    /// A product with column matrices: few positions.
    Columns,
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
    } else if pays_columns(l) {
        Algorithm::Columns
    } else {
        Algorithm::Direct
    }
}

/// Whether Winograd's scheme fits and is faster.
fn pays_winograd(l: &Layout) -> bool {
    // With fewer channels, tiles cost more than they save; with fewer tiles, the weights do. Tiles of one image are counted: its bits
    // do not depend on the others beside it.
    let tiles = l.output.h().div_ceil(2) * l.output.w().div_ceil(2);
    let channels = l.cin.min(l.cout);
    let dense = l.is_winograd() && channels >= 16 && l.cin * l.cout >= 512 && tiles >= 30;
    dense || l.is_winograd_strided() && channels >= 64 && tiles >= 100
}

/// Whether Winograd's scheme fits the gradient of the weights and is faster.
pub fn pays_winograd_weight(l: &Layout) -> bool {
    // With fewer channels, tiles cost more than they save; strips that are filled up cost as much as full ones.
    let (pairs, filled) = (l.cin * l.cout, l.cin.next_multiple_of(STRIP) * l.cout.next_multiple_of(STRIP));
    l.is_winograd() && pairs >= 512 && 3 * pairs >= 2 * filled
}

/// Whether a column matrix is faster: of few positions, for many sums. Those of one image are counted, as for Winograd's scheme.
fn pays_columns(l: &Layout) -> bool {
    l.groups == 1 && l.cout >= 16 && l.cin >= 16 && l.output.plane() <= 64
}

/// Whether it is so for the gradient of the input, too: the phases of a stride have few taps, each with a fold of its own.
pub fn pays_columns_backward(l: &Layout) -> bool {
    l.is_dense() || l.phase_len() <= 32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Conv2d, Shape};

    fn chosen([n, inputs, outputs, h, w]: [usize; 5], kernel: usize, conv: Conv2d) -> (Algorithm, bool) {
        let (x, weight) = (Shape::new(n, inputs, h, w), Shape::new(outputs, inputs / conv.groups, kernel, kernel));
        let l = Layout::new(x, weight, conv.output_shape(x, weight), &conv);
        (algorithm(&l), pays_winograd_weight(&l))
    }

    /// The table above, and the borders of its rules.
    #[test]
    fn every_shape_goes_the_way_of_the_table() {
        use Algorithm::{Columns, Depthwise, Direct, Pointwise, Winograd};
        let (three, strided) = (Conv2d::new(1, 1), Conv2d::new(2, 1));
        let depthwise = Conv2d { groups: 64, ..three };
        for (shape, kernel, conv, way, winograd_weight) in [
            ([1, 64, 256, 24, 80], 1, Conv2d::new(1, 0), Pointwise, false),
            ([1, 64, 64, 48, 160], 3, depthwise, Depthwise, false),
            ([1, 64, 64, 48, 160], 3, three, Winograd, true),
            ([4, 64, 64, 48, 160], 3, three, Winograd, true),
            ([1, 128, 128, 24, 80], 3, three, Winograd, true),
            ([1, 256, 256, 12, 40], 3, three, Winograd, true),
            ([1, 512, 512, 6, 20], 3, three, Winograd, true),
            ([1, 16, 16, 192, 640], 3, three, Direct, false),
            ([1, 16, 1, 192, 640], 3, three, Direct, false),
            ([1, 32, 16, 96, 320], 3, three, Winograd, true),
            ([4, 16, 32, 32, 96], 3, three, Winograd, true),
            ([4, 8, 8, 64, 192], 3, three, Direct, false),
            ([1, 64, 128, 48, 160], 3, strided, Winograd, false),
            ([1, 128, 256, 24, 80], 3, strided, Winograd, false),
            ([1, 256, 512, 12, 40], 3, strided, Direct, false),
            ([4, 16, 32, 64, 192], 3, strided, Direct, false),
            ([4, 3, 16, 64, 192], 3, strided, Direct, false),
            ([1, 3, 64, 192, 640], 7, Conv2d::new(2, 3), Direct, false),
            ([4, 128, 128, 2, 6], 3, three, Columns, true),
            ([4, 64, 128, 4, 12], 3, strided, Columns, false),
            // 30 tiles, 29, and a column matrix for none of them; with stride 2, 100 tiles and 99.
            ([1, 16, 32, 10, 12], 3, three, Winograd, true),
            ([1, 16, 32, 2, 58], 3, three, Direct, true),
            ([1, 16, 31, 10, 12], 3, three, Direct, false),
            ([1, 64, 64, 40, 40], 3, strided, Winograd, false),
            ([1, 64, 64, 36, 44], 3, strided, Direct, false),
            // 64 positions of one image, whatever lies beside it; 65.
            ([9, 16, 16, 8, 8], 3, three, Columns, false),
            ([1, 16, 16, 5, 13], 3, three, Direct, false),
            ([1, 24, 24, 20, 20], 3, three, Winograd, false),
        ] {
            assert_eq!(
                chosen(shape, kernel, conv),
                (way, winograd_weight),
                "{shape:?}, {kernel}x{kernel}, stride {:?}",
                conv.stride
            );
        }
    }
}
