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
//! | [`alignment`] | alignment with imaging plane and optical axis |
//! | [`ratios`] | depth-to-translation ratios |
//! | [`ratio_noise`], [`ratio_bias`] | what flow noise does to the ratios and to what they recover |
//! | [`recovery`] | the translation that a whole scene implies, and what a rotation error does to it |
//! | [`quadrature`] | integrals by fixed nodes |
//! | [`reported`] | numbers the paper reports, with the arithmetic behind them |
//! | [`loss_forms`] | the four geometric losses over lists of pixels |
//! | [`taped`] | the same geometry as differentiable operations |
//! | [`losses`] | the four losses on the tape |
//! | [`scenes`] | reference scenes and motions |
//! | [`ledger`] | every claim of the paper with its verdict and check |

pub mod alignment;
pub mod camera;
pub mod error;
pub mod flow;
pub mod homography;
pub mod ledger;
pub mod loss_forms;
pub mod losses;
pub mod motion;
pub mod quadrature;
pub mod ratio_bias;
pub mod ratio_noise;
pub mod ratios;
pub mod recovery;
pub mod reported;
pub mod scenes;
pub mod se3;
pub mod so3;
mod svd3;
pub mod taped;
#[cfg(test)]
mod testing;
pub mod trajectory;
pub mod umeyama;

pub use alignment::Convention;
pub use camera::Intrinsics;
pub use error::GeometryError;
pub use se3::Se3;
pub use trajectory::{StampedPose, Trajectory};
