//! Relative pose from semantic features and the flow of frozen features (SCIPaD; fengyi233/SCIPaD, `networks/posenet.py`).
//!
//! A ResNet-18 looks at both images at once. A frozen ResNet-50 looks at each on its own, and the correlation of its features in
//! small windows says where they went. This feature flow, the place on the image and, where given, the point cloud of the target
//! become positional features, which are added to the semantic ones from fine to coarse.

mod config;
mod decoder;
mod feature_flow;
mod frozen_block;
mod frozen_extractor;
mod injector;
mod net;
mod position;

pub use config::ScipadConfig;
pub use net::{ScipadPose, ScipadTrace};
