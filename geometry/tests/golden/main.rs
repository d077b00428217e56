//! Comparison with stored reference tensors.

mod losses;
mod pose_and_masks;
mod support;
mod warp;
