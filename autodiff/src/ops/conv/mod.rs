//! Kernels of the convolution: padding into phase planes, the direct product, the weight gradient.

pub mod direct;
pub(super) mod layout;
pub(super) mod weight;
pub mod weight_grad;
pub mod weight_outer;

/// Element types for which the kernels are compiled, once, in this crate: callers that are generic over the element type do not
/// compile them again.
pub trait ConvScalar: Sized {
    /// Runs a direct product.
    #[doc(hidden)]
    fn run_direct(task: direct::Direct<'_, Self>);
    /// Runs a weight gradient, `[output][pair]`.
    #[doc(hidden)]
    fn run_weight_grad(task: weight_grad::WeightGrad<'_, Self>) -> Vec<f64>;
    /// Runs a weight gradient of a strip of outputs, `[pair][output]`.
    #[doc(hidden)]
    fn run_weight_outer(task: weight_outer::WeightOuter<'_, Self>) -> Vec<f64>;
}

macro_rules! conv_scalar {
    ($t:ident) => {
        impl ConvScalar for $t {
            fn run_direct(task: direct::Direct<'_, Self>) {
                task.run();
            }
            fn run_weight_grad(task: weight_grad::WeightGrad<'_, Self>) -> Vec<f64> {
                task.run()
            }
            fn run_weight_outer(task: weight_outer::WeightOuter<'_, Self>) -> Vec<f64> {
                task.run()
            }
        }
    };
}

conv_scalar!(f32);
conv_scalar!(f64);
