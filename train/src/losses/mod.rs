//! The loss terms: one file each, value and gradient on the tape.

pub mod census;
pub mod charbonnier;
pub mod contextual_geometric;
pub mod cross_task;
pub mod dynamo;
pub mod flow_consistency;
pub mod flow_photometric;
pub mod flow_smoothness;
pub mod forward_backward;
pub mod guided_filter;
pub mod local_structure;
pub mod min_reprojection;
pub mod occluded_photometric;
pub mod photometric;
pub mod raft_sequence;
pub mod scale_anchor;
pub mod smoothness;
