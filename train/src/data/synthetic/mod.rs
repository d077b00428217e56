//! A procedural world: textured scenes of flat faces, ray cast, with exact depth, pose, flow and visibility for any two
//! frames of a sequence.
//!
//! A [`SyntheticConfig`] names a [`Preset`], a size, a seed and options; a [`SyntheticDataset`] renders from it on demand.
//! Every sequence is a world of its own, drawn from (seed, [`Split`], number of the sequence), so variety has no end and
//! held-out worlds are never training worlds. World axes: x right, y down, z forward; the ground is y = 0 outdoors; metres.
//!
//! What holds and what does not:
//! - Depth and pose are exact at pixel centres. The sky has depth 0, unknown.
//! - Colours do not depend on the view (Lambert's law, fixed sun), and textures are band-limited, so the true depth and pose
//!   warp one frame onto a neighbour up to the error of interpolation. `night` (light moves with the camera), `exposure` and
//!   `noise` break this on purpose.
//! - `moving_object`: the object is in image and depth; the flow follows it; `visible` is false on it.

mod cache;
mod config;
mod dataset;
mod face;
mod furniture;
mod handheld;
mod lateral;
mod material;
mod photometry;
mod random;
mod raycast;
mod render;
mod road;
mod street;
mod street_objects;
mod texture;
mod trajectory;
mod truth;
mod world;

#[cfg(test)]
mod tests;

pub use config::{MAX_FRAMES, Preset, Split, SyntheticConfig};
pub use dataset::SyntheticDataset;
