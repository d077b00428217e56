//! Optical flow by recurrent refinement over an all-pairs correlation volume (small RAFT).

mod config;
mod encoder;
mod gru;
mod motion_encoder;
mod net;
mod update;

pub use config::{FlowNetConfig, FlowNetKind};
pub use net::{FlowNet, FlowOptions, FlowTrace, ImageRange};
