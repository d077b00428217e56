//! Evaluation on plain data: depth maps and trajectories in, numbers out. Nothing here knows the tape or a network.
//!
//! | module | subject |
//! |---|---|
//! | [`depth_protocol`] | the choices behind a depth number |
//! | [`depth`] | the seven depth metrics of one image, and their mean |
//! | [`resize`] | predicted maps at the size of the truth |
//! | [`align`] | five ways to align trajectories |
//! | [`odometry`] | e_t, e_r, absolute trajectory error, relative pose error |
//! | [`motion`] | frame-to-frame rotation and translation-direction error |
//! | [`trivial`] | predictors that have learned nothing |
//! | [`depth_table`], [`motion_table`] | the trained row beside the trivial rows, on the same frames |
//!
//! [`Evaluation`] holds both tables; its JSON form has the field names as stable keys: `title`, `data`,
//! `depth.{protocol, frames, skipped, rows[], ratios[]}` with `rows[].{name, kind, abs_rel, sq_rel, rmse, rmse_log, a1, a2,
//! a3, images, skipped, scale_median, scale_spread, per_image[]}`, and `motion.{protocol, direction_frame, sequences, pairs,
//! rows[], ratios[]}` with `rows[].{name, kind, frame_to_frame, odometry}`, and `notes[]` where there are any. A number that is not available is `null`.

pub mod align;
pub mod depth;
pub mod depth_protocol;
pub mod depth_table;
mod error;
pub mod motion;
pub mod motion_table;
pub mod odometry;
pub mod resize;
mod table;
pub mod trivial;

use serde::Serialize;

pub use align::{AlignedTrajectory, Alignment, Arithmetic, align_trajectory};
pub use depth::{DepthEvaluator, DepthImage, DepthScores, DepthSummary, evaluate_depth_image};
pub use depth_protocol::{Crop, DepthProtocol, DepthScaling};
pub use depth_table::{DepthRow, DepthTable, DepthTableBuilder};
pub use error::EvalError;
pub use motion::{MotionErrors, follow, motion_errors, steps_of};
pub use motion_table::{MotionRow, MotionTable, MotionTableBuilder, OdometrySummary};
pub use odometry::{LengthErrors, OdometryErrors, OdometryProtocol, evaluate_odometry};
pub use resize::{resize_bilinear, resize_depth};
pub use table::{Grid, GridRow};
pub use trivial::{MeanDisparity, MeanMotion, TrivialDepth, mean_disparity};

/// Whether a row comes from trained networks or from a predictor that looks at nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum RowKind {
    /// The system under evaluation.
    Trained,
    /// A predictor that has learned nothing about the frame.
    Trivial,
}

/// One error of the trained row beside the best trivial row. Below 1 the trained row is better.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Ratio {
    /// Key of the error.
    pub metric: &'static str,
    /// Value of the trained row.
    pub trained: f64,
    /// Smallest value of the trivial rows.
    pub best_trivial: f64,
    /// Name of the row that has it.
    pub best_row: String,
    /// `trained / best_trivial`.
    pub ratio: f64,
}

impl Ratio {
    /// `None` when either side has no value, or the best trivial value is zero.
    fn of<'a>(metric: &'static str, rows: impl Iterator<Item = (&'a str, RowKind, Option<f64>)>) -> Option<Self> {
        let (mut trained, mut best) = (None, None::<(&str, f64)>);
        for (name, kind, value) in rows {
            match (kind, value) {
                (RowKind::Trained, value) => trained = trained.or(value),
                (RowKind::Trivial, Some(value)) if best.is_none_or(|(_, b)| value < b) => {
                    best = Some((name, value));
                }
                (RowKind::Trivial, _) => {}
            }
        }
        let (trained, (best_row, best_trivial)) = (trained?, best?);
        (best_trivial > 0.0).then(|| Self {
            metric,
            trained,
            best_trivial,
            best_row: best_row.to_owned(),
            ratio: trained / best_trivial,
        })
    }
}

/// The result of an evaluation: what was evaluated on what, depth rows and motion rows.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Evaluation {
    /// What was evaluated, for instance the name of the run.
    pub title: String,
    /// The data in a few words, for instance `held-out street worlds (seed 7)`; part of every table title, which adds the counts.
    pub data: String,
    /// Depth rows; absent without true depth.
    pub depth: Option<DepthTable>,
    /// Motion rows; absent without true poses.
    pub motion: Option<MotionTable>,
    /// Why something was not scored although there is truth for it.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
}

impl Evaluation {
    /// The tables as grids of formatted cells, depth first.
    pub fn grids(&self) -> Vec<Grid> {
        table::grids(self)
    }

    /// The tables and notes as text. The best value of a column carries a star, the last line is the ratio to the best
    /// trivial row.
    pub fn render_table(&self) -> String {
        let tables = self.grids().into_iter().map(|grid| table::render(&grid));
        let parts: Vec<String> = tables.chain(self.notes.iter().map(|note| format!("{}: {note}\n", self.data))).collect();
        if parts.is_empty() {
            return format!("{}: no ground truth, nothing to evaluate\n", self.data);
        }
        parts.join("\n")
    }

    /// Ratio of an error to the best trivial row, searched in depth and motion; `None` when it is not available.
    pub fn ratio(&self, metric: &str) -> Option<f64> {
        let depth = self.depth.iter().flat_map(|t| &t.ratios);
        let motion = self.motion.iter().flat_map(|t| &t.ratios);
        depth.chain(motion).find(|r| r.metric == metric).map(|r| r.ratio)
    }
}

#[cfg(test)]
#[path = "mod_tests.rs"]
mod tests;
