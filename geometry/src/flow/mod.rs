//! Optical flow of a static scene, one motion component a file.
//!
//! Flows are source pixel minus target pixel, in pixels. Depths are target depths along the
//! optical axis; translations share their unit.

pub mod gradients;
pub mod radial;
pub mod rigid;
pub mod rotational;
pub mod tangential;
pub mod translational;
pub mod uniformity;
