//! Differentiable versions of the geometry, as operations on a tape.
//!
//! Poses are rotation matrices (N,1,3,3) and translations (N,3,1,1); maps are (N,C,H,W) in pixels.
//! Rotations that leave the identity by little keep their digits: every kernel works with `R - I`.

pub mod alignment;
pub(crate) mod bands;
pub mod derotate;
pub mod masks;
pub mod matches;
pub mod pose;
pub mod projection;
pub mod rigid_flow;
pub mod smooth;
pub mod so3_exp;
pub mod visibility;
pub mod warp;
pub mod weighted;

pub use alignment::{align, translation_in_target_frame};
pub use derotate::{derotate, rotated_pixels};
pub use pose::{Pose, source_from_target};
pub use projection::{Divisor, Projection, SampleGrid, back_project, project};
pub use rigid_flow::rigid_flow;
pub use so3_exp::{RotationForm, so3_exp};
pub use warp::warp;

/// Depths at or below this value (in depth units) count as behind the camera: such pixels get zero
/// flow and no gradient, and the depth channel lets callers mask them.
pub const MIN_DEPTH: f64 = 1e-3;
