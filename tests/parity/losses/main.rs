//! Sampling, poses, masks and losses give the values and gradients of the reference.

mod compared;
mod image;
mod local_structure;
mod monodepth;
mod motion;
mod pose_and_masks;
mod rectify;
mod sc_pairs;
mod support;
mod warp;
