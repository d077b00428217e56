//! Depth rows: the trained network beside the trivial predictors, all on the same frames.

use serde::Serialize;

use super::depth::{DepthEvaluator, DepthSummary};
use super::depth_protocol::DepthProtocol;
use super::resize::resize_depth;
use super::trivial::TrivialDepth;
use super::{EvalError, Ratio, RowKind};
use crate::data::Map;

/// One row of the depth table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DepthRow {
    /// Name of the row.
    pub name: String,
    /// Trained or trivial.
    pub kind: RowKind,
    /// Its numbers.
    #[serde(flatten)]
    pub summary: DepthSummary,
}

/// All depth rows, made on the same frames with the same protocol.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DepthTable {
    /// How the numbers were made.
    pub protocol: DepthProtocol,
    /// Frames that were compared.
    pub frames: usize,
    /// Frames left out because no pixel was valid.
    pub skipped: usize,
    /// The trained row first, then the trivial rows.
    pub rows: Vec<DepthRow>,
    /// Trained row against the best trivial row, for the four errors.
    pub ratios: Vec<Ratio>,
}

/// Feeds every frame to the trained row and to all trivial rows.
#[derive(Clone, Debug)]
pub struct DepthTableBuilder {
    protocol: DepthProtocol,
    ours: (String, DepthEvaluator),
    trivial: Vec<(TrivialDepth, DepthEvaluator)>,
}

impl DepthTableBuilder {
    /// A table with one trained row called `name` and the given trivial rows.
    ///
    /// **Errors** when the protocol makes no sense.
    pub fn new(name: impl Into<String>, protocol: DepthProtocol, trivial: Vec<TrivialDepth>) -> Result<Self, EvalError> {
        let evaluator = DepthEvaluator::new(protocol)?;
        Ok(Self {
            protocol,
            ours: (name.into(), evaluator.clone()),
            trivial: trivial.into_iter().map(|t| (t, evaluator.clone())).collect(),
        })
    }

    /// Adds one frame: predicted depth of any size (resized as disparity), true depth in metres (0 unknown), and
    /// optionally a mask at the size of the truth.
    ///
    /// **Errors** as [`super::depth::evaluate_depth_image`].
    pub fn add(&mut self, prediction: &Map, truth: &Map, mask: Option<&[bool]>) -> Result<(), EvalError> {
        let resized = resize_depth(prediction, truth.height, truth.width)?;
        self.ours.1.add(&resized, truth, mask)?;
        for (trivial, evaluator) in &mut self.trivial {
            evaluator.add(&trivial.predict(truth.height, truth.width), truth, mask)?;
        }
        Ok(())
    }

    /// The table. **Errors** when no frame had a valid pixel.
    pub fn finish(self) -> Result<DepthTable, EvalError> {
        let mut rows = vec![DepthRow { name: self.ours.0, kind: RowKind::Trained, summary: self.ours.1.finish()? }];
        for (trivial, evaluator) in self.trivial {
            rows.push(DepthRow { name: trivial.name().to_owned(), kind: RowKind::Trivial, summary: evaluator.finish()? });
        }
        Ok(DepthTable {
            protocol: self.protocol,
            frames: rows[0].summary.images,
            skipped: rows[0].summary.skipped,
            ratios: ratios(&rows),
            rows,
        })
    }
}

fn ratios(rows: &[DepthRow]) -> Vec<Ratio> {
    let of = |metric: &'static str, get: fn(&DepthSummary) -> f64| {
        let values = rows.iter().map(|row| (row.name.as_str(), row.kind, Some(get(&row.summary))));
        Ratio::of(metric, values)
    };
    [
        of("abs_rel", |s| s.scores.abs_rel),
        of("sq_rel", |s| s.scores.sq_rel),
        of("rmse", |s| s.scores.rmse),
        of("rmse_log", |s| s.scores.rmse_log),
    ]
    .into_iter()
    .flatten()
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_see_the_same_frames_and_the_best_trivial_row_is_named() {
        let map = |data: &[f32]| Map { height: 1, width: 3, data: data.to_vec() };
        let trivial = vec![TrivialDepth::Constant(1.0), TrivialDepth::MeanDisparity(map(&[1.0, 0.5, 0.4]))];
        let mut builder = DepthTableBuilder::new("dimode", DepthProtocol::default(), trivial).unwrap();
        builder.add(&map(&[1.0, 2.0, 3.6]), &map(&[1.0, 2.0, 4.0]), None).unwrap();
        builder.add(&map(&[1.0, 2.0, 4.0]), &map(&[0.0, 0.0, 0.0]), None).unwrap();
        let table = builder.finish().unwrap();
        assert_eq!((table.frames, table.skipped, table.rows.len()), (1, 1, 3));
        assert!((table.rows[0].summary.scores.abs_rel - 0.1 / 3.0).abs() < 1e-7);
        assert!((table.rows[1].summary.scores.abs_rel - 0.5).abs() < 1e-7);
        assert!((table.rows[2].summary.scores.abs_rel - 0.125).abs() < 1e-7);
        let ratio = &table.ratios[0];
        assert_eq!((ratio.metric, ratio.best_row.as_str()), ("abs_rel", "mean disparity map"));
        assert!((ratio.ratio - 0.1 / 3.0 / 0.125).abs() < 1e-6);
    }
}
