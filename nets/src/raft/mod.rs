//! Optical flow by recurrent refinement over an all-pairs correlation volume (RAFT, small and full).

mod config;
mod encoder;
mod gru;
mod motion_encoder;
mod net;
mod padding;
mod update;
mod upsampler;

pub use config::{FlowNetConfig, FlowNetKind, RaftFull, RaftVariant};
pub use net::{FlowNet, FlowOptions, FlowTrace, ImageRange};
pub use padding::PaddingStyle;
