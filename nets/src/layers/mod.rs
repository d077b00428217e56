//! Building blocks: a path, sizes, and a `forward` that takes variables and returns variables.

mod basic_block;
mod batch_norm;
mod bottleneck;
mod conv2d;
mod reflect_conv;

pub use basic_block::BasicBlock;
pub use batch_norm::BatchNorm;
pub use bottleneck::{Bottleneck, Norm};
pub use conv2d::ConvLayer;
pub use reflect_conv::ReflectConv;
