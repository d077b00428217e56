//! Depth, pose and optical-flow networks with the parameter names of the reference modules.
//!
//! A network is a plain description: [`Network::blueprint`] lists every tensor it needs, and
//! `forward` runs it on variables of a tape. The numbers live apart, in a [`ParamSet`], and a
//! [`Binder`] puts them on a tape for one step:
//!
//! ```
//! use dimode_autodiff::{Shape, Tape, Tensor};
//! use dimode_nets::{Binder, DepthNet, DepthNetConfig, Mode, Network};
//!
//! let net = DepthNet::new(DepthNetConfig::nano());
//! let mut params = net.init::<f32>(7);
//! let tape = Tape::new();
//! let mut binder = Binder::new(&tape, &params, Mode::Train);
//! let images = tape.constant(Tensor::full(Shape::new(1, 3, 64, 96), 0.5));
//! let disparities = net.forward(&mut binder, images);
//! let gradients = tape.backward(disparities[0].mean());
//! assert_eq!(binder.gradients(&gradients).len(), params.trainable().count());
//! let statistics = binder.into_statistics();
//! params.apply_statistics(&statistics);
//! ```

mod binder;
mod blueprint;
mod d_hrnet;
mod depth_decoder;
mod depth_net;
mod hash;
mod kind;
mod lite_mono;
mod net_kind;
mod network;
mod param_set;
mod params;
mod pose_decoder;
mod pose_net;
mod rectify_net;
mod replace_file;
mod resnet_depth;
mod resnet_encoder;
mod resnet_pose;
mod size;

pub mod fill;
pub mod init;
pub mod layers;
pub mod raft;
pub mod scipad;
pub mod weights;

pub use binder::{Binder, Mode, ParamGradient, StatisticsUpdate};
pub use blueprint::{Blueprint, Declaration};
pub use d_hrnet::{DHrNet, DHrNetConfig};
pub use depth_decoder::DepthDecoder;
pub use depth_net::{DepthNet, DepthNetConfig, DepthNetKind};
pub use init::Init;
pub use kind::UnknownName;
pub use lite_mono::{LiteMono, LiteMonoConfig};
pub use net_kind::{NetKind, UnknownNet};
pub use network::Network;
pub use param_set::ParamSet;
pub use params::{Entry, Kind, Params};
pub use pose_decoder::PoseDecoder;
pub use pose_net::{PoseNet, PoseNetConfig, PoseNetKind, PosePrediction};
pub use raft::{FlowNet, FlowNetConfig, FlowNetKind, FlowOptions, FlowTrace, ImageRange, PaddingStyle};
pub use rectify_net::{RectifyNet, RectifyNetConfig};
pub use replace_file::replace_file;
pub use resnet_depth::{ResNetDepth, ResNetDepthConfig};
pub use resnet_encoder::{ResNetConfig, ResNetEncoder};
pub use resnet_pose::{ResNetPose, ResNetPoseConfig};
pub use scipad::{ScipadConfig, ScipadPose, ScipadTrace};
pub use size::UnfitSize;
pub use weights::WeightError;
