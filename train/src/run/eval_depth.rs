//! Scoring depth: of a trained run, or of a folder of depth pictures.

use std::path::{Path, PathBuf};

use anyhow::Result;

use super::TrainedModel;
use super::conclude::means_of;
use super::frames::frames_to_score;
use crate::data::{DataError, Dataset, Map, read_depth_png};
use crate::eval::{Crop, DepthProtocol, DepthScaling, DepthTable, DepthTableBuilder, Evaluation, TrivialDepth};
use crate::progress::Progress;

/// What is scored.
#[derive(Clone, Debug)]
pub enum DepthSource {
    /// A trained run, on a folder or (without one) on worlds that were not trained on.
    Run {
        /// Folder of the run.
        run: PathBuf,
        /// Folder of frames with true depth.
        data: Option<PathBuf>,
        /// Sequences to use; empty for all.
        sequences: Vec<String>,
    },
    /// 16-bit depth pictures of equal names in two folders.
    Pictures {
        /// True depth.
        truth: PathBuf,
        /// Predicted depth.
        prediction: PathBuf,
    },
}

/// What to score and how.
#[derive(Clone, Debug)]
pub struct EvalDepthRequest {
    /// What is scored.
    pub source: DepthSource,
    /// The protocol to begin with; none for the bounds of the run, or for the defaults for pictures.
    pub protocol: Option<DepthProtocol>,
    /// What is asked to differ from it.
    pub changes: ProtocolChanges,
}

/// Choices behind the numbers that were asked for.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ProtocolChanges {
    /// Smallest true depth that counts, metres.
    pub min_depth: Option<f64>,
    /// Largest true depth that counts, metres.
    pub max_depth: Option<f64>,
    /// How scale is found.
    pub scaling: Option<DepthScaling>,
    /// Part of the image that counts.
    pub crop: Option<Crop>,
}

impl ProtocolChanges {
    fn on(self, base: DepthProtocol) -> DepthProtocol {
        DepthProtocol {
            min_depth: self.min_depth.unwrap_or(base.min_depth),
            max_depth: self.max_depth.unwrap_or(base.max_depth),
            scaling: self.scaling.unwrap_or(base.scaling),
            crop: self.crop.unwrap_or(base.crop),
            clamp: base.clamp,
        }
    }
}

/// Scores depth beside constant depth and, for a run, the mean disparity map of its training frames, on the same frames.
///
/// **Errors** of the run and the data; when no frame has true depth; [`crate::eval::EvalError`].
pub fn eval_depth(request: &EvalDepthRequest, progress: &dyn Progress) -> Result<Evaluation> {
    let (title, data, table) = match &request.source {
        DepthSource::Run { run, data, sequences } => {
            let model = TrainedModel::load(run)?;
            let protocol = request.changes.on(request.protocol.unwrap_or_else(|| model.config.eval.protocol()));
            let dataset = frames_to_score(&model.config, data.as_deref(), sequences)?;
            let table = score_run(&model, dataset.as_ref(), protocol, progress)?;
            (run.display().to_string(), dataset.name(), table)
        }
        DepthSource::Pictures { truth, prediction } => {
            let protocol = request.changes.on(request.protocol.unwrap_or_default());
            let table = score_pictures(truth, prediction, protocol, progress)?;
            (prediction.display().to_string(), truth.display().to_string(), table)
        }
    };
    Ok(Evaluation { title, data, depth: Some(table), motion: None, notes: Vec::new() })
}

fn score_run(
    model: &TrainedModel,
    dataset: &dyn Dataset,
    protocol: DepthProtocol,
    progress: &dyn Progress,
) -> Result<DepthTable> {
    let mut trivial = vec![TrivialDepth::Constant(1.0)];
    trivial.extend(means_of(&model.config)?.0.map(TrivialDepth::MeanDisparity));
    let mut table = DepthTableBuilder::new("this run", protocol, trivial)?;
    let total: usize = (0..dataset.sequence_count()).map(|s| dataset.sequence_len(s)).sum();
    progress.start(total as u64, "frames");
    let (mut done, mut scored) = (0, 0);
    for sequence in 0..dataset.sequence_count() {
        for index in 0..dataset.sequence_len(sequence) {
            let frame = dataset.frame(sequence, index)?;
            done += 1;
            if let Some(truth) = &frame.depth {
                let prediction = model.depth(&[&frame]).pop().expect("one map for one frame");
                table.add(&prediction, truth, None)?;
                scored += 1;
            }
            progress.step(done, "");
        }
    }
    progress.finish();
    if scored == 0 {
        return Err(no_depth(dataset).into());
    }
    Ok(table.finish()?)
}

fn no_depth(dataset: &dyn Dataset) -> DataError {
    DataError::Missing {
        path: PathBuf::from(dataset.name()),
        what: "true depth".to_owned(),
        advice: "depth can only be scored on data that has it, for instance what 'dimode synth' writes".to_owned(),
    }
}

fn score_pictures(truth: &Path, prediction: &Path, protocol: DepthProtocol, progress: &dyn Progress) -> Result<DepthTable> {
    let names = pictures_in(truth)?;
    let mut table = DepthTableBuilder::new("prediction", protocol, vec![TrivialDepth::Constant(1.0)])?;
    progress.start(names.len() as u64, "pictures");
    for (done, name) in names.iter().enumerate() {
        let known = read_depth_png(&truth.join(name))?;
        let path = prediction.join(name);
        let predicted = read_depth_png(&path)?;
        check_prediction(&path, &predicted)?;
        table.add(&predicted, &known, None)?;
        progress.step(done as u64 + 1, name);
    }
    progress.finish();
    Ok(table.finish()?)
}

/// Names of the PNG files in a folder, in order.
fn pictures_in(folder: &Path) -> Result<Vec<String>, DataError> {
    let entries = std::fs::read_dir(folder).map_err(|error| DataError::read(folder, "folder of depth pictures", error))?;
    let mut names = Vec::new();
    for entry in entries {
        let entry = entry.map_err(|error| DataError::read(folder, "folder of depth pictures", error))?;
        let name = entry.file_name().to_string_lossy().into_owned();
        if name.to_lowercase().ends_with(".png") {
            names.push(name);
        }
    }
    names.sort();
    if names.is_empty() {
        return Err(DataError::malformed(folder, "no PNG files", "name the folder that holds the 16-bit depth pictures"));
    }
    Ok(names)
}

/// A prediction has no unknown pixels; 0 in the file would become an endless disparity.
fn check_prediction(path: &Path, depth: &Map) -> Result<(), DataError> {
    match depth.data.iter().position(|&value| value <= 0.0) {
        Some(at) => {
            let reason = format!("pixel ({}, {}) has no depth", at % depth.width, at / depth.width);
            Err(DataError::malformed(path, reason, "a prediction needs a depth above 0 for every pixel"))
        }
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::write_depth_png;
    use crate::progress::Silent;

    fn folders(prediction: f32) -> (tempfile::TempDir, EvalDepthRequest) {
        let place = tempfile::tempdir().unwrap();
        let (truth, predicted) = (place.path().join("gt"), place.path().join("pred"));
        for (folder, factor) in [(&truth, 1.0), (&predicted, prediction)] {
            std::fs::create_dir(folder).unwrap();
            let values: Vec<f32> = (0..8).map(|i| factor * (4.0 + 4.0 * i as f32)).collect();
            write_depth_png(&folder.join("000000.png"), &Map::from_vec(2, 4, values)).unwrap();
        }
        let source = DepthSource::Pictures { truth, prediction: predicted };
        (place, EvalDepthRequest { source, protocol: None, changes: ProtocolChanges::default() })
    }

    #[test]
    fn a_scaled_copy_is_perfect_after_median_scaling() {
        let (_place, request) = folders(0.5);
        let result = eval_depth(&request, &Silent).unwrap();
        let rows = result.depth.unwrap().rows;
        assert!(rows[0].summary.scores.abs_rel < 1e-9);
        assert!((rows[0].summary.scale_median - 2.0).abs() < 1e-9);
        assert!(rows[1].summary.scores.abs_rel > 0.3, "the constant row is beside it");
    }

    #[test]
    fn missing_and_empty_pictures_are_named() {
        let (place, request) = folders(0.0);
        let message = eval_depth(&request, &Silent).unwrap_err().to_string();
        assert!(message.contains("pixel (0, 0) has no depth"), "{message}");
        std::fs::remove_file(place.path().join("pred/000000.png")).unwrap();
        let message = eval_depth(&request, &Silent).unwrap_err().to_string();
        assert!(message.contains("pred/000000.png"), "{message}");
    }
}
