//! The losses of colours on the tape.
//!
//! | module | what it asks for |
//! |---|---|
//! | [`photometric`] | two images look alike: dissimilarity and difference |
//! | [`min_reprojection`] | the source that explains a pixel best counts, unless nothing moved |
//! | [`fused_reprojection`] | the mean of both along the rigid flow, in one pass over the image |
//! | [`smoothness`] | depth changes where the image has an edge |

pub mod fused_reprojection;
pub mod min_reprojection;
pub mod photometric;
mod rows;
mod similarity;
pub mod smoothness;
