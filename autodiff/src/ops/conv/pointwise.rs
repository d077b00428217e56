//! Convolutions of one tap that read every pixel in place: bare matrix products, without any copy.
//!
//! A unit of work is a tile of pixels of one image, or a block of output channels of the weights.

use std::sync::Arc;

use super::after::After;
use super::layout::Layout;
use crate::gemm::View;
use crate::{Activation, Pool, Scalar, par};

/// Pixels of a tile.
const PIXELS: usize = 512;
/// Output channels of a block of weights.
const OUTPUTS: usize = 64;

/// `y = a(w x + b)`.
pub fn forward<T: Scalar>(l: &Layout, x: &[T], w: &[T], after: After<'_, T>, pool: &Arc<Pool<T>>) -> Vec<T> {
    let plane = l.output.plane();
    let mut y = pool.take(l.output.len());
    for (image, y) in y.chunks_exact_mut(l.cout * plane).enumerate() {
        let x = &x[image * l.cin * plane..][..l.cin * plane];
        T::gemm_by_columns(y, View::new(w, l.cout, l.cin), View::new(x, l.cin, plane), PIXELS);
    }
    if after.bias.is_some() || after.activation != Activation::Identity {
        par::for_each_chunk(&mut y, plane, |i, y| {
            let b = after.bias(i % l.cout);
            y.iter_mut().for_each(|y| *y += b);
            after.activate(y);
        });
    }
    y
}

/// Fills `dx = w^T g`.
pub fn backward_input<T: Scalar>(l: &Layout, g: &[T], w: &[T], dx: &mut [T]) {
    let plane = l.output.plane();
    for (image, dx) in dx.chunks_exact_mut(l.cin * plane).enumerate() {
        let g = &g[image * l.cout * plane..][..l.cout * plane];
        T::gemm_by_columns(dx, View::transpose_of(w, l.cin, l.cout), View::new(g, l.cout, plane), PIXELS);
    }
}

/// Adds `dw = g x^T`, image by image.
pub fn backward_weight<T: Scalar>(l: &Layout, x: &[T], g: &[T], dw: &mut [T]) {
    let plane = l.output.plane();
    par::for_each_chunk(dw, OUTPUTS * l.cin, |block, dw| {
        let outputs = dw.len() / l.cin;
        for image in 0..l.output.n() {
            let g = &g[(image * l.cout + block * OUTPUTS) * plane..][..outputs * plane];
            let x = &x[image * l.cin * plane..][..l.cin * plane];
            T::gemm(dw, View::new(g, outputs, plane), View::transpose_of(x, plane, l.cin), true);
        }
    });
}
