//! The four geometric losses of DiMoDE on the tape.
//!
//! [`AlignedPair`] prepares one batch of (target, source) pairs; [`planar()`], [`axial()`],
//! [`tangential()`] and [`radial()`] each turn it into a [`LossTerm`]: one value an image, the number of
//! pixels behind it, and the mean over images with enough pixels. Pixels of different images or sources are
//! never pooled. All forms are invariant under a common scale of depths and translation, except
//! where a threshold in depth units acts.
//!
//! Masks may hold weights between 0 and 1, such as one minus the probability of motion: every mean and variance is weighted.
//!
//! [`fused::geometric_losses`] gives the same four as one operation, for the forms that matter most.
//!
//! Arguments at pixels outside a mask are replaced by constants before any division, root or angle, so
//! neither values nor gradients of unusable pixels can spread.

mod arccos;
pub mod axial;
pub mod fused;
#[cfg(test)]
mod laws;
mod options;
mod pair;
pub mod planar;
pub mod radial;
pub mod ratio_term;
mod static_mask;
pub mod tangential;
mod term;

pub use axial::{AxialForm, axial, axial_angles};
pub use options::LossOptions;
pub use pair::{AlignedPair, PairInputs};
pub use planar::{PlanarForm, planar, planar_angles};
pub use radial::{RadialForm, radial};
pub use ratio_term::{RatioTerm, ratio_term};
pub use static_mask::StaticMask;
pub use tangential::{TangentialForm, tangential};
pub use term::{Angles, LossTerm};
