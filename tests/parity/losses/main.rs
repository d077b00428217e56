//! Sampling, poses, masks and losses give the values and gradients of the reference.

mod image;
mod motion;
mod pose_and_masks;
mod sampling;
mod support;
mod warp;
