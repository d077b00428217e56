//! Laws of the losses, in every form: gradients, finite numbers and masks in scenes with hazards, and what a loss must not see.
//!
//! - The gradient is that of central differences, also beside pixels behind the camera, out of view, on the principal point or
//!   masked, and beside images of which nothing is left.
//! - Values and gradients are finite in double and single precision, also at exact solutions, without motion, and with anything
//!   at masked pixels.
//! - Masked pixels have no gradient at all.
//! - The order of a batch, a common scale of depths and translation, and a rotation added to the camera change nothing where
//!   they should not, and the truth of a static scene costs nothing.

mod camera_rotation;
mod contextual;
mod cross_task;
mod dynamo;
mod flow;
mod geometric;
mod geometric_truth;
mod local_structure;
mod monodepth;
mod ranking;
mod rectify;
mod sc_depth;
mod scenes;
mod support;
