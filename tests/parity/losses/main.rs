//! Sampling, poses, masks and losses give the values and gradients of the reference.

mod compared;
mod competitors;
mod dynamo;
mod flow_losses;
mod flow_masks;
mod image;
mod local_structure;
mod monodepth;
mod motion;
mod pose;
mod rectify;
mod sc_pairs;
mod support;
mod warp;
