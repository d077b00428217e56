//! The loss terms: one file each, value and gradient on the tape.

pub mod depth_ranking;
pub mod edge_pairs;
pub mod flow_consistency;
pub mod flow_photometric;
pub mod guided_filter;
pub mod local_structure;
pub mod masked;
pub mod min_reprojection;
pub mod multi_scale;
pub mod photometric;
pub mod pseudo_depth;
pub mod raft_sequence;
pub mod rectify;
pub mod relative_normal;
pub mod sc_depth_pair;
pub mod sc_sfm_pair;
pub mod scale_anchor;
pub mod smoothness;
pub mod ssim;
pub mod view_pair;
