//! Camera geometry and the loss equations of DiMoDE.
//!
//! Conventions: camera axes x right, y down, z forward; pixel centres at integers, `u` the column
//! and `v` the row; target points are carried to the source camera by `X_s = R X_t + t`, named
//! `source_from_target`; trajectories hold `world_from_camera`.
//!
//! | module | subject |
//! |---|---|
//! | [`camera`] | pinhole intrinsics |
//! | [`so3`], [`se3`] | rotations and rigid motions |
//! | [`trajectory`] | pose sequences and their text files |
//! | [`umeyama`] | alignment of point sets |
//! | [`homography`], [`flow`] | image motion of the single motion components |
//! | [`motion`] | split of a motion into rotation, tangential and radial translation |
//! | [`removal`] | the two orders in which rotation and translation come off a point |
//! | [`warp`] | images read along a flow |
//! | [`photometric`] | similarity of two windows of colours |
//! | [`deviation`] | what wrong estimates leave over |
//! | [`backprojection`] | source points from sampled depth |
//! | [`alignment`] | alignment with imaging plane and optical axis |
//! | [`motion_statistics`] | sizes of recorded motions, and what the printed alignment costs on them |
//! | [`ratios`] | depth-to-translation ratios |
//! | [`ratio_noise`], [`ratio_bias`] | what flow noise does to the ratios and to what they recover |
//! | [`recovery`] | the translation that a whole scene implies, and what a rotation error does to it |
//! | [`quadrature`] | integrals by fixed nodes |
//! | [`reported`] | numbers the paper reports, with the arithmetic behind them |
//! | [`loss_forms`] | the four geometric losses over lists of pixels |
//! | [`aligned_scene`] | a whole scene after the alignments |
//! | [`noise`] | what pixel noise costs the direction losses |
//! | [`sensitivity`] | first-order responses of flow directions to errors |
//! | [`observability`] | which motions the direction losses can see |
//! | [`taped`] | the same geometry as differentiable operations |
//! | [`losses`] | the four losses on the tape |
//! | [`image_losses`] | the losses of colours on the tape |
//! | [`scenes`] | reference scenes and motions |
//! | [`ledger`] | every claim of the paper with its verdict and check |

pub mod aligned_scene;
pub mod alignment;
pub mod backprojection;
pub mod camera;
pub mod deviation;
pub mod error;
pub mod flow;
pub mod homography;
pub mod image_losses;
pub mod ledger;
pub mod loss_forms;
pub mod losses;
pub mod motion;
pub mod motion_statistics;
pub mod noise;
pub mod observability;
pub mod photometric;
pub mod quadrature;
pub mod ratio_bias;
pub mod ratio_noise;
pub mod ratios;
pub mod recovery;
pub mod removal;
pub mod reported;
pub mod scenes;
pub mod se3;
pub mod sensitivity;
pub mod so3;
mod svd3;
pub mod taped;
#[cfg(test)]
mod testing;
pub mod trajectory;
pub mod umeyama;
pub mod warp;

pub use alignment::Convention;
pub use camera::Intrinsics;
pub use error::GeometryError;
pub use se3::Se3;
pub use trajectory::{StampedPose, Trajectory};
