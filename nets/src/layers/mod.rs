//! Building blocks: a path, sizes, and a `forward` that takes variables and returns variables.

mod basic_block;
mod batch_norm;
mod bottleneck;
mod conv2d;
mod drop_path;
mod layer_norm;
mod linear;
mod norm;
mod reflect_conv;
mod residual_block;

pub use basic_block::BasicBlock;
pub use batch_norm::{BatchNorm, TrainingStatistics};
pub use bottleneck::Bottleneck;
pub use conv2d::ConvLayer;
pub use drop_path::DropPath;
pub use layer_norm::LayerNorm;
pub use linear::LinearLayer;
pub use norm::{Norm, NormLayer};
pub use reflect_conv::ReflectConv;
pub use residual_block::ResidualBlock;
