//! Pictures as SVG text, made of small parts: a sheet, framed axes, arrows, heat maps.
//!
//! A [`sheet::Sheet`] carries its own style, so the file stands alone. Nothing refers to anything outside and no element has an
//! id, so several sheets fit into one page. Equal numbers give equal bytes.

pub mod arrows;
pub mod frame;
pub mod heat;
pub mod sheet;
