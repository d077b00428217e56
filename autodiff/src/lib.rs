//! Tape-based reverse-mode differentiation over planar tensors, with gradients that are checked rather than believed.
//!
//! A [`Tensor`] has shape `[n, c, h, w]` over one contiguous buffer, one plane after the other. A [`Tape`] records operations
//! on [`Var`] handles; [`Tape::backward`] returns the [`Gradients`] of a scalar. Everything is generic over `f32` (training)
//! and `f64` (proofs).
//!
//! A line through four points, by gradient descent, after a check of the gradient:
//!
//! ```
//! use dimode_autodiff::{GradCheck, Shape, Tape, Tensor, Var, gradcheck};
//!
//! /// Mean square of `slope x + offset - y`.
//! fn loss<'t>([slope, offset, x, y]: [Var<'t, f64>; 4]) -> Var<'t, f64> {
//!     let everywhere = |v: Var<'t, f64>| v.broadcast_to(x.shape());
//!     everywhere(slope).mul(x).add(everywhere(offset)).sub(y).square().mean()
//! }
//!
//! let points = |values: [f64; 4]| Tensor::from_vec(Shape::new(1, 1, 1, 4), values.to_vec());
//! let (x, y) = (points([0.0, 1.0, 2.0, 3.0]), points([1.0, 3.0, 5.0, 7.0]));
//! let mut all = [Tensor::scalar(0.0), Tensor::scalar(0.0), x, y];
//!
//! let report = gradcheck(&all, |_, v| loss([v[0], v[1], v[2], v[3]]), GradCheck::default());
//! assert!(report.is_ok(), "{report}");        // names the worst entries
//!
//! for _ in 0..200 {
//!     let tape = Tape::new();
//!     let v = all.each_ref().map(|value| tape.leaf(value.clone()));
//!     let grads = tape.backward(loss(v));
//!     for k in [0, 1] {
//!         all[k] = Tensor::scalar(all[k].item() - 0.1 * grads.wrt(v[k]).item());
//!     }
//! }
//! assert!((all[0].item() - 2.0).abs() < 1e-4 && (all[1].item() - 1.0).abs() < 1e-4);
//! ```
//!
//! Operations live one to a file in [`ops`]; anyone can define another with [`Tape::push`]. Each one carries a [`proof`]: its
//! values and gradients against a plain loop in forward mode and against central differences, with faults planted to see that
//! the comparison notices. [`gradcheck()`] does the same for any function, by differences alone.
//!
//! | to | use |
//! |---|---|
//! | stop a gradient, read one in the middle | [`Var::detach`], [`Var::retain_grad`] |
//! | free values during the backward pass, use buffers again | [`Tape::backward_and_free`], [`Tape::with_pool`] |
//! | compute a long segment twice instead of keeping it | [`Tape::checkpoint`] |
//! | find where a number stops being finite | [`Tape::refusing_non_finite`] |
//!
//! Wrong shapes are errors of the programmer: operations panic with their name, the shapes and the rule. No tensor has an axis of
//! size zero. NaN and infinities are not refused (training must see where they
//! come from), but they show: a value that depends on NaN is NaN. [`gradcheck()`] refuses them.
//!
//! The same inputs give the same bits on any number of threads: work is cut into chunks of fixed size ([`par`]) and
//! reductions run in a fixed order.

mod activation;
mod arccos;
mod checkpoint;
mod erfc;
mod fast;
pub mod gemm;
mod grad_sink;
pub mod gradcheck;
mod gradients;
pub mod ops;
pub mod par;
mod pixel_grid;
mod pool;
pub mod proof;
pub mod rng;
mod scalar;
mod segments;
mod shape;
pub mod simd;
mod tape;
mod tensor;

pub use activation::Activation;
pub use grad_sink::{GradSink, GradSlot};
pub use gradcheck::{GradCheck, gradcheck};
pub use gradients::Gradients;
pub use ops::conv2d::{Conv2d, PadMode};
pub use ops::matmul::MatMul;
pub use pixel_grid::pixel_grid;
pub use pool::Pool;
pub use scalar::Scalar;
pub use shape::Shape;
pub use tape::{Tape, Var};
pub use tensor::Tensor;
