//! Kernels of the convolution: padding into phase planes, the direct product, the weight gradient. `choice` says which one when.

mod after;
mod backward_input;
mod choice;
pub mod columns;
pub mod depthwise;
pub mod direct;
mod forward;
pub(super) mod layout;
mod pointwise;
mod weight;
pub mod weight_grad;
pub mod weight_outer;
mod winograd;
pub mod winograd_kernels;
pub mod winograd_products;
mod winograd_schemes;
mod winograd_weight;
pub mod winograd_weight_kernels;

use std::sync::Arc;

pub(super) use after::After;
use choice::{Algorithm, algorithm, pays_columns_backward};
use layout::Layout;

use crate::{Pool, Scalar};

/// The output, by the way that [`choice`] names.
pub(super) fn forward<T: Scalar>(l: &Layout, x: &[T], w: &[T], after: After<'_, T>, pool: &Arc<Pool<T>>) -> Vec<T> {
    match algorithm(l) {
        Algorithm::Pointwise => pointwise::forward(l, x, w, after, pool),
        Algorithm::Depthwise => depthwise::forward(l, x, w, after, pool),
        Algorithm::Winograd => winograd::forward(l, x, w, after, pool),
        Algorithm::Columns => columns::forward(l, x, w, after, pool),
        Algorithm::Direct => forward::forward(l, x, w, after, pool),
    }
}

/// Fills `dx`, whatever it held.
pub(super) fn backward_input<T: Scalar>(l: &Layout, g: &[T], w: &[T], dx: &mut [T], pool: &Arc<Pool<T>>) {
    match algorithm(l) {
        Algorithm::Pointwise => pointwise::backward_input(l, g, w, dx),
        Algorithm::Depthwise => depthwise::backward_input(l, g, w, dx, pool),
        Algorithm::Winograd => winograd::backward_input(l, g, w, dx, pool),
        Algorithm::Columns if pays_columns_backward(l) => columns::backward_input(l, g, w, dx, pool),
        Algorithm::Columns | Algorithm::Direct => backward_input::backward_input(l, g, w, dx, pool),
    }
}

/// Adds the gradient of the weights.
pub(super) fn backward_weight<T: Scalar>(l: &Layout, x: &[T], g: &[T], dw: &mut [T], pool: &Arc<Pool<T>>) {
    match algorithm(l) {
        Algorithm::Pointwise => pointwise::backward_weight(l, x, g, dw),
        Algorithm::Depthwise => depthwise::backward_weight(l, x, g, dw, pool),
        _ if choice::pays_winograd_weight(l) => winograd_weight::backward_weight(l, x, g, dw, pool),
        Algorithm::Winograd | Algorithm::Columns | Algorithm::Direct => weight::backward_weight(l, x, g, dw, pool),
    }
}

/// Element types for which the kernels are compiled, once, in this crate: callers that are generic over the element type do not
/// compile them again.
pub trait ConvScalar: Sized {
    /// Runs a direct product.
    #[doc(hidden)]
    fn run_direct(task: direct::Direct<'_, '_, Self>);
    /// Makes rows of a column matrix.
    #[doc(hidden)]
    fn run_gather(task: columns::Gather<'_, Self>);
    /// Runs a plane by plane convolution.
    #[doc(hidden)]
    fn run_rows(task: depthwise::Rows<'_, Self>);
    /// Runs its weight gradient.
    #[doc(hidden)]
    fn run_products(task: depthwise::Products<'_, Self>);
    /// Transforms weights of a Winograd product.
    #[doc(hidden)]
    fn run_winograd_weights(task: winograd_kernels::Weights<'_, Self>);
    /// Transforms an input plane of a Winograd product.
    #[doc(hidden)]
    fn run_winograd_inputs(task: winograd_kernels::Inputs<'_, '_, Self>);
    /// Runs a Winograd product.
    #[doc(hidden)]
    fn run_winograd_products(task: winograd_products::Products<'_, Self>);
    /// Transforms a Winograd product to an output plane.
    #[doc(hidden)]
    fn run_winograd_outputs(task: winograd_kernels::Outputs<'_, Self>);
    /// Transforms tiles for a Winograd gradient of the weights.
    #[doc(hidden)]
    fn run_winograd_tiles(task: winograd_weight_kernels::Tiles<'_, Self>);
    /// Sums its products.
    #[doc(hidden)]
    fn run_winograd_sums(task: winograd_weight_kernels::Sums<'_, Self>);
    /// Transforms them to taps.
    #[doc(hidden)]
    fn run_winograd_taps(task: winograd_weight_kernels::Taps<'_, Self>);
    /// Runs a weight gradient, `[output][pair]`.
    #[doc(hidden)]
    fn run_weight_grad(task: weight_grad::WeightGrad<'_, Self>) -> Vec<f64>;
    /// Runs a weight gradient of one or two strips of outputs.
    #[doc(hidden)]
    fn run_weight_outer(task: weight_outer::WeightOuter<'_, Self>);
}

macro_rules! conv_scalar {
    ($t:ident) => {
        impl ConvScalar for $t {
            fn run_direct(task: direct::Direct<'_, '_, Self>) {
                task.run();
            }
            fn run_gather(task: columns::Gather<'_, Self>) {
                task.run();
            }
            fn run_rows(task: depthwise::Rows<'_, Self>) {
                task.run();
            }
            fn run_products(task: depthwise::Products<'_, Self>) {
                task.run();
            }
            fn run_winograd_weights(task: winograd_kernels::Weights<'_, Self>) {
                task.run();
            }
            fn run_winograd_inputs(task: winograd_kernels::Inputs<'_, '_, Self>) {
                task.run();
            }
            fn run_winograd_products(task: winograd_products::Products<'_, Self>) {
                task.run();
            }
            fn run_winograd_outputs(task: winograd_kernels::Outputs<'_, Self>) {
                task.run();
            }
            fn run_winograd_tiles(task: winograd_weight_kernels::Tiles<'_, Self>) {
                task.run();
            }
            fn run_winograd_sums(task: winograd_weight_kernels::Sums<'_, Self>) {
                task.run();
            }
            fn run_winograd_taps(task: winograd_weight_kernels::Taps<'_, Self>) {
                task.run();
            }
            fn run_weight_grad(task: weight_grad::WeightGrad<'_, Self>) -> Vec<f64> {
                task.run()
            }
            fn run_weight_outer(task: weight_outer::WeightOuter<'_, Self>) {
                task.run();
            }
        }
    };
}

conv_scalar!(f32);
conv_scalar!(f64);
