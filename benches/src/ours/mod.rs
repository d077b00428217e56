//! The computations of this project that are timed.

pub mod conv;
pub mod encoder;
pub mod loss_core;
pub mod networks;
pub mod pieces;
pub mod step;
