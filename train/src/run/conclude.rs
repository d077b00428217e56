//! What follows the last step: evaluation on frames that were not trained on, pictures, trajectories, the report.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Result;
use dimode_autodiff::{Tape, Tensor};
use dimode_geometry::{Se3, Trajectory, taped};

use super::eval_odometry::OdometryChanges;
use super::frames::for_each_frame;
use super::{RunFolder, Stopped, TrainRequest, TrainedModel, held_out_worlds, training_frames};
use crate::config::Config;
use crate::data::{DataError, Dataset, FlowMap, Frame, Map};
use crate::eval::{
    Alignment, DepthTable, DepthTableBuilder, EvalError, Evaluation, MeanDisparity, MeanMotion, MotionTable, MotionTableBuilder,
    OdometryProtocol, TrivialDepth, align_trajectory, follow,
};
use crate::memory::PeakMemory;
use crate::model::{Weights, stack};
use crate::progress::Progress;
use crate::report::{
    Curve, CurveGroup, ReportInput, SamplePicture, StageMark, TrajectoryPlot, write_depth_png16, write_json, write_report,
    write_trajectory,
};
use crate::runlog;
use crate::schedule::Schedule;

/// Training sequences from which the trivial rows take their means.
const MEAN_SEQUENCES: usize = 32;
/// Sequences of which the report shows a frame and a path.
const SHOWN: usize = 4;

/// The result of a run.
pub struct Concluded {
    /// Metrics.
    pub evaluation: Evaluation,
}

/// Evaluates and writes `metrics.json`, `report.html`, trajectories and depth pictures into the run's folder.
///
/// # Errors
/// When frames cannot be read or files cannot be written, and [`Stopped`] soon after `stop` is set.
pub fn conclude(
    request: &TrainRequest,
    folder: &RunFolder,
    training: &dyn Dataset,
    trained: &TrainedModel,
    progress: &dyn Progress,
    stop: &AtomicBool,
) -> Result<Concluded> {
    let held_out = match &request.config.data.path {
        Some(_) => None,
        None => Some(held_out_worlds(&request.config)?),
    };
    let frames: &dyn Dataset = held_out.as_ref().map_or(training, |d| d);
    let means = means(training)?;
    let (sequences, depth, notes) = predict(request, folder, trained, frames, means.0, progress, stop)?;
    let paths = sequences.iter().filter_map(|s| Some((s.name.as_str(), &s.steps[..], s.truth.as_ref()?)));
    let motion = motion_table(&paths.collect::<Vec<_>>(), means.1, &OdometryChanges::default())?;
    let kind = if held_out.is_some() { "not trained on" } else { "trained on without its truth" };
    let (title, data) = (request.out.display().to_string(), format!("{}, {kind}", frames.name()));
    let evaluation = Evaluation { title, data, depth, motion, notes };
    let report = report(request, folder, trained, &sequences, &evaluation)?;
    write_report(&folder.report(), &report)?;
    write_json(&folder.metrics(), &evaluation)?;
    Ok(Concluded { evaluation })
}

/// What is kept of a sequence.
struct Predicted {
    name: String,
    /// `next_from_this` between neighbours.
    steps: Vec<Se3>,
    truth: Option<Trajectory>,
    shown: Option<Shown>,
}

/// The frame of a sequence that the report shows, and the one after it.
struct Shown {
    frame: Arc<Frame>,
    next: Arc<Frame>,
    depth: Map,
    /// `next_from_frame`.
    step: Se3,
}

/// Predicts every sequence, scores its depth where the truth is known, and writes depth pictures (16 bit, 256 steps a metre)
/// and trajectories (KITTI and TUM). Gives the sequences, the scores, and why there are none although there is truth.
fn predict(
    request: &TrainRequest,
    folder: &RunFolder,
    trained: &TrainedModel,
    dataset: &dyn Dataset,
    mean_disparity: Option<Map>,
    progress: &dyn Progress,
    stop: &AtomicBool,
) -> Result<(Vec<Predicted>, Option<DepthTable>, Vec<String>)> {
    let mut trivial = vec![TrivialDepth::Constant(1.0)];
    trivial.extend(mean_disparity.map(TrivialDepth::MeanDisparity));
    let mut table = DepthTableBuilder::new("this run", request.config.eval.protocol(), trivial)?;
    let trajectories = new_folder(folder.path().join("trajectories"))?;
    let all = 0..dataset.sequence_count();
    progress.start(all.clone().map(|s| dataset.sequence_len(s) as u64).sum(), "evaluation");
    let (mut sequences, mut done) = (Vec::new(), 0);
    for sequence in all {
        let (name, len) = (dataset.sequence_name(sequence), dataset.sequence_len(sequence));
        let place = new_folder(folder.path().join("depth").join(&name))?;
        let middle = (len / 2).min(len.saturating_sub(2));
        let (mut poses, mut frame_shown, mut next_shown) = (Vec::with_capacity(len), None, None);
        let steps = trained.walk(dataset, sequence, &mut |index, frame, depth| {
            if let Some(truth) = &frame.depth {
                table.add(&depth, truth, None)?;
            }
            write_depth_png16(&place.join(format!("{}.png", frame.name)), &in_metres(&depth, frame.depth.as_ref()))?;
            poses.push(frame.world_from_camera);
            if index == middle {
                frame_shown = Some((frame.clone(), depth));
            } else if index == middle + 1 {
                next_shown = Some(frame.clone());
            }
            done += 1;
            progress.step(done, "");
            if stop.load(Ordering::Relaxed) { Err(Stopped.into()) } else { Ok(()) }
        })?;
        let truth = poses.into_iter().collect::<Option<Vec<Se3>>>().map(Trajectory::from_poses);
        let mut path = path_like(&steps, truth.as_ref())?;
        for (pose, &time) in path.poses.iter_mut().zip(dataset.times(sequence).into_iter().flatten()) {
            pose.stamp = Some(time);
        }
        write_trajectory(&trajectories, &name, &path)?;
        let shown = match (sequence < SHOWN, frame_shown, next_shown) {
            (true, Some((frame, depth)), Some(next)) => Some(Shown { frame, next, depth, step: steps[middle] }),
            _ => None,
        };
        sequences.push(Predicted { name, steps, truth, shown });
    }
    progress.finish();
    let (table, notes) = match table.finish() {
        Ok(table) => (Some(table), Vec::new()),
        Err(EvalError::NoValidPixels { images: 0 }) => (None, Vec::new()),
        Err(error @ EvalError::NoValidPixels { .. }) => (None, vec![format!("depth is not scored: {error}")]),
        Err(other) => return Err(other.into()),
    };
    Ok((sequences, table, notes))
}

fn new_folder(path: PathBuf) -> Result<PathBuf, DataError> {
    std::fs::create_dir_all(&path).map_err(|e| DataError::write(&path, e))?;
    Ok(path)
}

/// The predicted path, from where the true one begins if that is known.
fn path_like(steps: &[Se3], truth: Option<&Trajectory>) -> Result<Trajectory> {
    Ok(match truth {
        Some(truth) => follow(steps, truth)?,
        None => Trajectory::accumulate(steps),
    })
}

/// The motions of sequences (name, `next_from_this` between neighbours, truth) beside trivial ones; none without a sequence.
/// The protocol is the one for paths as long as these, with some changes.
pub(super) fn motion_table(
    sequences: &[(&str, &[Se3], &Trajectory)],
    mean: Option<MeanMotion>,
    changes: &OdometryChanges,
) -> Result<Option<MotionTable>> {
    // The shortest sub-sequence of the usual protocol is 100 m.
    let long = sequences.iter().any(|(.., truth)| truth.path_length() > 100.0);
    let usual = if long { OdometryProtocol::default() } else { OdometryProtocol::small_world() };
    let mut table = MotionTableBuilder::new("this run", changes.on(usual), mean);
    for (name, steps, truth) in sequences {
        table.add_sequence(name, steps, truth)?;
    }
    Ok(if sequences.is_empty() { None } else { Some(table.finish()?) })
}

/// The means of the frames that a run was trained on, or none if they have been moved away since.
pub(super) fn means_of(config: &Config) -> Result<(Option<Map>, Option<MeanMotion>)> {
    match config.data.path.as_ref().is_none_or(|path| path.exists()) {
        true => means(training_frames(config)?.as_ref()),
        false => Ok((None, None)),
    }
}

/// Mean disparity map and mean motion of the training data, as far as its truth is known.
fn means(training: &dyn Dataset) -> Result<(Option<Map>, Option<MeanMotion>)> {
    let (mut disparity, mut motions) = (MeanDisparity::new(), Vec::new());
    for sequence in 0..training.sequence_count().min(MEAN_SEQUENCES) {
        let mut before = None;
        for_each_frame(training, sequence, &mut |frame| {
            if let Some(depth) = &frame.depth {
                disparity.add(depth)?;
            }
            if let (Some(a), Some(b)) = (before, frame.world_from_camera) {
                motions.push(Se3::inverse(&b).compose(&a));
            }
            before = frame.world_from_camera;
            Ok(())
        })?;
    }
    // Its one error: no pixel is known.
    let disparity = disparity.finish().ok();
    let motion = if motions.is_empty() { None } else { Some(MeanMotion::fit(&motions)?) };
    Ok((disparity, motion))
}

/// Predicted depth at the scale of the truth where it is known, else with median 10.
fn in_metres(depth: &Map, truth: Option<&Map>) -> Map {
    let median = |values: Vec<f32>| {
        let mut values = values;
        values.sort_by(f32::total_cmp);
        values.get(values.len() / 2).copied()
    };
    let known = |m: &Map| m.data.iter().zip(truth.map_or(&m.data, |t| &t.data)).filter(|p| *p.1 > 0.0).map(|p| *p.0).collect();
    let ours = median(known(depth)).unwrap_or(1.0);
    let wanted = truth.and_then(|t| median(t.data.iter().copied().filter(|&z| z > 0.0).collect())).unwrap_or(10.0);
    Map::from_vec(depth.height, depth.width, depth.data.iter().map(|z| z * wanted / ours).collect())
}

fn report(
    request: &TrainRequest,
    folder: &RunFolder,
    trained: &TrainedModel,
    sequences: &[Predicted],
    evaluation: &Evaluation,
) -> Result<ReportInput> {
    let config = &request.config;
    let records = runlog::read(&folder.log())?;
    let seconds: f64 = records.iter().map(|r| r.seconds).sum();
    let memory = records.iter().map(|r| r.memory).fold(PeakMemory::default(), PeakMemory::max);
    let parameters = Weights::NAMES.into_iter().zip(trained.weights.sets().map(|set| set.parameter_count()));
    let parameters = parameters.filter(|(_, count)| *count > 0);
    let mut facts = vec![
        ("loss".to_owned(), config.loss.preset.to_string()),
        ("seed".to_owned(), config.seed.to_string()),
        ("steps x batch".to_owned(), format!("{} x {}", config.train.steps, config.train.batch)),
        ("training time".to_owned(), format!("{:.0} s", seconds)),
        ("peak memory of training".to_owned(), memory.to_string()),
        ("frame size".to_owned(), format!("{} x {}", config.data.width, config.data.height)),
    ];
    facts.extend(parameters.map(|(name, count)| (format!("{name} network"), format!("{count} parameters"))));
    let mut begin = 0;
    let mut stage_marks = Vec::new();
    for (name, end) in Schedule::new(&config.train).ends() {
        stage_marks.push(StageMark { step: begin, label: name.to_owned() });
        begin = end;
    }
    let scale = "Depth and translation of monocular video have no common scale: depth is scaled by the ratio of medians, paths \
                 are aligned as named beside them.";
    Ok(ReportInput {
        title: format!("DiMoDE run: {}", evaluation.title),
        command: request.command.clone(),
        config_toml: config.to_toml(),
        facts,
        stage_marks,
        curves: curves(&records),
        samples: sequences.iter().filter_map(|s| s.shown.as_ref().map(|shown| picture(trained, &s.name, shown))).collect(),
        trajectories: sequences.iter().take(SHOWN).map(path).collect::<Result<_>>()?,
        evaluation: Some(evaluation.clone()),
        notes: std::iter::once(scale.to_owned()).chain(evaluation.notes.iter().cloned()).collect(),
    })
}

fn path(sequence: &Predicted) -> Result<TrajectoryPlot> {
    let predicted = path_like(&sequence.steps, sequence.truth.as_ref())?;
    let aligned = sequence.truth.as_ref().map(|truth| align_trajectory(&predicted, truth, Alignment::Sim3));
    Ok(match aligned {
        Some(Ok(aligned)) => TrajectoryPlot::aligned(&sequence.name, Alignment::Sim3, &aligned),
        None | Some(Err(_)) => TrajectoryPlot::predicted(&sequence.name, &predicted),
    })
}

fn curves(records: &[runlog::StepRecord]) -> Vec<Curve> {
    let mut curves: Vec<Curve> = Vec::new();
    let mut add =
        |name: String, group, step: u64, value: f64| match curves.iter_mut().find(|c| c.name == name && c.group == group) {
            Some(curve) => curve.points.push([step as f64, value]),
            None => curves.push(Curve { name, group, points: vec![[step as f64, value]] }),
        };
    for record in records {
        for (name, &value) in &record.terms {
            add(name.clone(), CurveGroup::Loss, record.step, value);
        }
        for (name, &value) in &record.valid {
            add(name.clone(), CurveGroup::ValidShare, record.step, value);
        }
        for (name, &value) in &record.gradient_norms {
            add(name.clone(), CurveGroup::GradientNorm, record.step, value);
        }
        add("learning rate".to_owned(), CurveGroup::Other, record.step, record.learning_rate);
    }
    curves
}

/// A frame with depth, optical and rigid flow to the next frame.
fn picture(trained: &TrainedModel, sequence: &str, shown: &Shown) -> SamplePicture {
    let Shown { frame, next, depth, step } = shown;
    let flow = trained.model.predict_flow(&trained.weights, &stack([&frame.image]), &stack([&next.image]));
    let tape = Tape::<f32>::new();
    let (rotation, translation) = taped::pose::pose_tensors(&[*step]);
    let shape = dimode_autodiff::Shape::new(1, 1, depth.height, depth.width);
    let rigid = taped::rigid_flow(
        tape.constant(Tensor::from_vec(shape, depth.data.clone())),
        tape.constant(rotation),
        tape.constant(translation),
        &[frame.intrinsics],
    )
    .value();
    let map = |t: &Tensor<f32>| FlowMap {
        height: depth.height,
        width: depth.width,
        u: t.plane(0, 0).to_vec(),
        v: t.plane(0, 1).to_vec(),
    };
    SamplePicture {
        caption: format!("sequence {sequence}, frame {}", frame.name),
        image: frame.image.clone(),
        predicted_depth: depth.clone(),
        true_depth: frame.depth.clone(),
        optical_flow: Some(map(&flow)),
        rigid_flow: Some(map(&rigid)),
    }
}
