//! The loss terms: one file each, value and gradient on the tape.

pub mod flow_consistency;
pub mod flow_photometric;
pub mod guided_filter;
pub mod local_structure;
pub mod min_reprojection;
pub mod photometric;
pub mod raft_sequence;
pub mod scale_anchor;
pub mod smoothness;
