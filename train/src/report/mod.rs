//! What a run leaves behind to be looked at: one page that opens offline, and result files.
//!
//! [`ReportInput`] is plain data; [`write_report`] turns it into one HTML file with its style, charts (SVG) and pictures
//! (PNG) inside, without any reference to something outside. [`files`] writes results for other programs. [`ledger`] and
//! [`figures`] tell what `dimode verify` found, in words and in pictures.

mod base64;
pub mod colour;
mod curves;
pub mod drawing;
mod error;
pub mod figures;
pub mod files;
pub mod flow_wheel;
mod html;
pub mod ledger;
pub mod picture;
mod pixel_text;
pub mod scale;
pub mod svg;

use std::path::Path;

use dimode_geometry::Trajectory;
use serde::Serialize;

pub use error::ReportError;
pub use files::{write_depth_png16, write_json, write_trajectory};
pub use html::render_html;

use crate::data::{FlowMap, Image, Map, write_atomic};
use crate::eval::{AlignedTrajectory, Alignment, Evaluation};

/// Everything that a report shows. Empty parts are left out of the page.
#[derive(Clone, Debug, Default, Serialize)]
pub struct ReportInput {
    /// Heading of the page.
    pub title: String,
    /// The command that made the run, as it was typed.
    pub command: String,
    /// The configuration, as TOML.
    pub config_toml: String,
    /// Short facts (name, value) for the head of the page: seed, steps, duration, parameters and so on.
    pub facts: Vec<(String, String)>,
    /// Where stages begin.
    pub stage_marks: Vec<StageMark>,
    /// Logged values over optimiser steps.
    pub curves: Vec<Curve>,
    /// Frames with predictions; the pictures are not part of the serialised form.
    #[serde(skip)]
    pub samples: Vec<SamplePicture>,
    /// Paths seen from above.
    pub trajectories: Vec<TrajectoryPlot>,
    /// Metrics.
    pub evaluation: Option<Evaluation>,
    /// Remarks, one paragraph each.
    pub notes: Vec<String>,
}

/// The beginning of a stage.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StageMark {
    /// First optimiser step of the stage.
    pub step: u64,
    /// Name, for instance `stage 2`.
    pub label: String,
}

/// What a curve shows; decides where it is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum CurveGroup {
    /// A loss term or the total: a chart of its own.
    Loss,
    /// Share of pixels that a term uses, 0 to 1: all in one chart.
    ValidShare,
    /// Gradient norm of a term: all in one chart.
    GradientNorm,
    /// Anything else (learning rate, validation error): a chart of its own.
    Other,
}

/// One logged quantity.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Curve {
    /// Name, for instance `l_pho`.
    pub name: String,
    /// What it shows.
    pub group: CurveGroup,
    /// Pairs of optimiser step and value in rising order; values that are not finite leave a gap.
    pub points: Vec<[f64; 2]>,
}

/// One frame with what was predicted for it.
#[derive(Clone, Debug)]
pub struct SamplePicture {
    /// What frame it is.
    pub caption: String,
    /// The frame.
    pub image: Image,
    /// Predicted depth at any scale; shown at the scale of the truth (median ratio) where that is known.
    pub predicted_depth: Map,
    /// True depth in metres, 0 unknown, of the same size as the prediction.
    pub true_depth: Option<Map>,
    /// Flow of the flow network, target to source, pixels.
    pub optical_flow: Option<FlowMap>,
    /// Flow that predicted depth and motion imply, pixels.
    pub rigid_flow: Option<FlowMap>,
}

/// What a path of a [`TrajectoryPlot`] is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PathKind {
    /// Ground truth.
    Truth,
    /// Prediction of the trained network.
    Predicted,
}

/// One path, seen from above.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PathLine {
    /// What it is.
    pub kind: PathKind,
    /// Points (x, z), metres when a ground truth fixes the scale.
    pub xz: Vec<[f64; 2]>,
}

/// Paths of one sequence in the x-z plane (x right, z forward of the first camera).
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TrajectoryPlot {
    /// Name of the sequence.
    pub name: String,
    /// How the prediction was aligned, in words.
    pub alignment: String,
    /// Whether the unit is the metre.
    pub metric: bool,
    /// The paths.
    pub paths: Vec<PathLine>,
}

fn seen_from_above(trajectory: &Trajectory) -> Vec<[f64; 2]> {
    let positions = trajectory.positions();
    positions.iter().map(|p| [p.x, p.z]).collect()
}

impl TrajectoryPlot {
    /// Prediction and truth after [`crate::eval::align_trajectory`] with the alignment named here.
    pub fn aligned(name: &str, alignment: Alignment, both: &AlignedTrajectory) -> Self {
        let path = |kind, trajectory| PathLine { kind, xz: seen_from_above(trajectory) };
        Self {
            name: name.to_owned(),
            alignment: format!("{} (scale {:.4})", alignment.label(), both.scale),
            metric: true,
            paths: vec![path(PathKind::Truth, &both.truth), path(PathKind::Predicted, &both.prediction)],
        }
    }

    /// A prediction without ground truth, at its own scale.
    pub fn predicted(name: &str, trajectory: &Trajectory) -> Self {
        Self {
            name: name.to_owned(),
            alignment: "no ground truth, the unit is arbitrary".to_owned(),
            metric: false,
            paths: vec![PathLine { kind: PathKind::Predicted, xz: seen_from_above(&trajectory.anchored_at_first()) }],
        }
    }
}

/// Writes the page to `path`, whole or not at all.
///
/// **Errors** when the page cannot be made or the file cannot be written.
pub fn write_report(path: &Path, input: &ReportInput) -> Result<(), ReportError> {
    Ok(write_atomic(path, render_html(input)?.as_bytes())?)
}
