//! The computations of this project that are timed.

pub mod adam;
pub mod conv;
pub mod encoder;
pub mod loss_core;
pub mod losses;
pub mod networks;
pub mod pieces;
mod sizes;
pub mod step;

use crate::Case;

/// The cases whose allocations are counted, each with what of it: steps, and both parts of the loss core.
pub fn counted() -> [(Box<dyn Case>, &'static str); 4] {
    [
        (Box::new(step::StepCase::monodepth2(1)), "step"),
        (Box::new(step::StepCase::nano(4)), "step"),
        (Box::new(loss_core::LossCase::new(1, 192, 640)), "geom"),
        (Box::new(loss_core::LossCase::new(1, 192, 640)), "photo"),
    ]
}
