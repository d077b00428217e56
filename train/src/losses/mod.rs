//! The loss terms: one file each, value and gradient on the tape. Four terms of colours stand in
//! [`dimode_geometry::image_losses`], next to the flow that they read.
//!
//! | module | what it asks for | source |
//! |---|---|---|
//! | **Images** | | |
//! | [`photometric`] | the warped image looks like the target: dissimilarity and difference, fused | paper; Monodepth2 |
//! | [`ssim`] | structural dissimilarity with any window | Wang et al. 2004 |
//! | [`min_reprojection`] | the source that explains a pixel best counts, unless nothing moved | Monodepth2 |
//! | [`fused_reprojection`] | the two above along the rigid flow, in one pass over the image | Monodepth2 |
//! | [`multi_scale`] | total over several scales of disparity | Monodepth2 |
//! | [`sc_depth_pair`], [`sc_sfm_pair`] | two views agree in colour and depth; both read a [`view_pair`] | sc_depth_pl; SC-SfMLearner-Release |
//! | **Depth** | | |
//! | [`smoothness`] | depth changes where the image has an edge | Monodepth2 |
//! | [`local_structure`] | normals are those of a [`pseudo_depth`], which may come from a [`guided_filter`] | paper; SC-DepthV3 |
//! | [`relative_normal`] | so are angles between normals, at [`edge_pairs`] | SC-DepthV3 |
//! | [`depth_ranking`] | so is which pixel of a pair is farther | SC-DepthV3 |
//! | [`below_ground`] | nothing is seen below a [`ground_plane`] | Dynamo-Depth |
//! | [`scale_anchor`] | the mean disparity stays where it is | this program |
//! | **Motion** | | |
//! | [`dimode_geometry::losses`] | rotation, tangential and radial motion of DiMoDE | paper |
//! | [`rectify`] | the rotation that is removed is the one that was there | SC-Depth V2 |
//! | [`dynamo`] | flow of moving things, and a mask that tells them apart | Dynamo-Depth |
//! | [`contextual_geometric`] | the depth that flow and motion imply is the predicted one | DCPI-Depth |
//! | [`contextual_divergence`] | the divergence of the flow goes with the slope of the depth | DCPI-Depth |
//! | [`rigid_agreement`] | optical and rigid flow agree, relative to the flow | DCPI-Depth |
//! | [`cross_task`], [`flow_consistency`] | rigid and optical flow agree | DF-Net |
//! | **Optical flow** | | |
//! | [`flow_data`] | the image warped by each of a sequence of flows looks like the target | paper |
//! | [`occluded_photometric`] | the same of one flow with occluded pixels painted black | ARFlow |
//! | [`census`] | neighbours differ alike in both images, whatever the brightness | UnFlow, ARFlow, SMURF |
//! | [`flow_smoothness`] | flow changes where the image has an edge | DF-VO, ARFlow, SMURF |
//! | [`forward_backward`] | following a flow there and another back ends at the start | DF-VO |
//! | [`raft_sequence`] | each of a sequence of flows is the true one | RAFT |
//! | **Parts** | | |
//! | [`charbonnier`], [`masked`], [`gated`] | a robust penalty; means over chosen pixels of a batch, and over those below a gate | |

pub mod below_ground;
pub mod census;
pub mod charbonnier;
pub mod contextual_divergence;
pub mod contextual_geometric;
pub mod cross_task;
pub mod depth_ranking;
pub mod dynamo;
pub mod edge_pairs;
pub mod flow_consistency;
pub mod flow_data;
pub mod flow_smoothness;
pub mod forward_backward;
pub mod gated;
pub mod ground_plane;
pub mod guided_filter;
pub mod local_structure;
pub mod masked;
pub mod multi_scale;
pub mod occluded_photometric;
pub mod pseudo_depth;
pub mod raft_sequence;
pub mod rectify;
pub mod relative_normal;
pub mod rigid_agreement;
pub mod sc_depth_pair;
pub mod sc_sfm_pair;
pub mod scale_anchor;
pub mod ssim;
pub mod view_pair;

pub use dimode_geometry::image_losses::{fused_reprojection, min_reprojection, photometric, smoothness};
