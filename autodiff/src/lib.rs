//! Tape-based reverse-mode differentiation over planar tensors, with gradients that are checked rather than believed.
//!
//! A [`Tensor`] has shape `[n, c, h, w]` over one contiguous buffer, one plane after the other. A [`Tape`] records operations
//! on [`Var`] handles; [`Tape::backward`] returns the [`Gradients`] of a scalar. Everything is generic over `f32` (training)
//! and `f64` (proofs).
//!
//! ```
//! use dimode_autodiff::{Shape, Tape, Tensor};
//!
//! let tape = Tape::<f64>::new();
//! let x = tape.leaf(Tensor::from_vec(Shape::new(1, 1, 1, 3), vec![1.0, -2.0, 3.0]));
//! let loss = x.mul(x).sum();                 // sum of squares
//! let grads = tape.backward(loss);
//! assert_eq!(loss.value().item(), 14.0);
//! assert_eq!(grads.wrt(x).data(), [2.0, -4.0, 6.0]);
//! ```
//!
//! Operations live one to a file in [`ops`]; anyone can define another with [`Tape::push`]. [`gradcheck()`] compares the
//! recorded gradients of any function with central differences.
//!
//! The same inputs give the same bits on any number of threads: work is cut into chunks of fixed size ([`par`]) and
//! reductions run in a fixed order.

mod erfc;
mod fast;
pub mod gemm;
pub mod gradcheck;
pub mod ops;
pub mod par;
mod pixel_grid;
mod pool;
pub mod proof;
pub mod rng;
mod scalar;
mod shape;
pub mod simd;
mod tape;
mod tensor;

pub use gradcheck::{GradCheck, gradcheck};
pub use ops::conv2d::{Conv2d, PadMode};
pub use ops::matmul::MatMul;
pub use pixel_grid::pixel_grid;
pub use pool::Pool;
pub use scalar::Scalar;
pub use shape::Shape;
pub use tape::{GradSink, GradSlot, Gradients, Tape, Var};
pub use tensor::Tensor;
