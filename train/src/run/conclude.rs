//! What follows the last step: evaluation on frames that were not trained on, pictures, trajectories, the report.

use anyhow::Result;
use dimode_autodiff::{Tape, Tensor};
use dimode_geometry::{Se3, Trajectory, taped};

use super::{RunFolder, TrainRequest, TrainedModel, held_out_worlds};
use crate::data::{Dataset, FlowMap, Frame, Map};
use crate::eval::{
    Alignment, DepthProtocol, DepthTableBuilder, Evaluation, MeanDisparity, MeanMotion, MotionTableBuilder, OdometryProtocol,
    TrivialDepth, align_trajectory, follow,
};
use crate::model::stack;
use crate::progress::Progress;
use crate::report::{
    Curve, CurveGroup, ReportInput, SamplePicture, StageMark, TrajectoryPlot, write_depth_png16, write_json, write_report,
    write_trajectory,
};
use crate::runlog;
use crate::schedule::Schedule;

/// Training sequences from which the trivial rows take their means.
const MEAN_SEQUENCES: usize = 32;
/// Frames that are predicted at a time.
const CHUNK: usize = 16;
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
/// When frames cannot be read or files cannot be written.
pub fn conclude(
    request: &TrainRequest,
    folder: &RunFolder,
    training: &dyn Dataset,
    trained: &TrainedModel,
    progress: &dyn Progress,
) -> Result<Concluded> {
    let held_out = match &request.config.data.path {
        Some(_) => None,
        None => Some(held_out_worlds(&request.config)?),
    };
    let frames: &dyn Dataset = held_out.as_ref().map_or(training, |d| d);
    let sequences = predict(trained, frames, progress)?;
    let evaluation = evaluate(request, training, frames, &sequences, held_out.is_some())?;
    write_outputs(folder, &sequences)?;
    let report = report(request, folder, trained, &sequences, &evaluation)?;
    write_report(&folder.report(), &report)?;
    write_json(&folder.metrics(), &evaluation)?;
    Ok(Concluded { evaluation })
}

/// A sequence with everything predicted for it.
struct Predicted {
    name: String,
    frames: Vec<std::sync::Arc<Frame>>,
    depth: Vec<Map>,
    /// `next_from_this` between neighbours.
    steps: Vec<Se3>,
    truth: Option<Trajectory>,
}

fn predict(trained: &TrainedModel, dataset: &dyn Dataset, progress: &dyn Progress) -> Result<Vec<Predicted>> {
    progress.start(dataset.sequence_count() as u64, "evaluation");
    let sequences = (0..dataset.sequence_count()).map(|s| {
        let indices: Vec<usize> = (0..dataset.sequence_len(s)).collect();
        let loaded = dimode_autodiff::par::map_indices(indices.len(), |f| dataset.frame(s, f));
        let frames = loaded.into_iter().collect::<Result<Vec<_>, _>>()?;
        let views: Vec<&Frame> = frames.iter().map(|f| f.as_ref()).collect();
        let depth = views.chunks(CHUNK).flat_map(|part| trained.depth(part)).collect();
        let last = views.len() - 1;
        let steps = (0..last).step_by(CHUNK).flat_map(|at| trained.motions(&views[at..=(at + CHUNK).min(last)])).collect();
        let poses: Option<Vec<Se3>> = frames.iter().map(|f| f.world_from_camera).collect();
        progress.step(s as u64 + 1, "");
        Ok(Predicted { name: dataset.sequence_name(s), frames, depth, steps, truth: poses.map(Trajectory::from_poses) })
    });
    let sequences = sequences.collect();
    progress.finish();
    sequences
}

fn evaluate(
    request: &TrainRequest,
    training: &dyn Dataset,
    evaluated: &dyn Dataset,
    sequences: &[Predicted],
    held_out: bool,
) -> Result<Evaluation> {
    let settings = &request.config.eval;
    let protocol = DepthProtocol { min_depth: settings.min_depth, max_depth: settings.max_depth, ..DepthProtocol::default() };
    let means = means(training)?;
    let mut trivial = vec![TrivialDepth::Constant(1.0)];
    trivial.extend(means.0.map(TrivialDepth::MeanDisparity));
    let mut depth = DepthTableBuilder::new("this run", protocol, trivial)?;
    // The shortest sub-sequence of the usual protocol is 100 m.
    let long = sequences.iter().flat_map(|s| &s.truth).any(|t| t.path_length() > 100.0);
    let odometry = if long { OdometryProtocol::default() } else { OdometryProtocol::small_world() };
    let mut motion = MotionTableBuilder::new("this run", odometry, means.1);
    let (mut with_depth, mut with_truth) = (false, false);
    for sequence in sequences {
        for (frame, predicted) in sequence.frames.iter().zip(&sequence.depth) {
            if let Some(truth) = &frame.depth {
                depth.add(predicted, truth, None)?;
                with_depth = true;
            }
        }
        if let Some(truth) = &sequence.truth {
            motion.add_sequence(&sequence.name, &sequence.steps, truth)?;
            with_truth = true;
        }
    }
    let frames: usize = sequences.iter().map(|s| s.frames.len()).sum();
    let kind = if held_out { "not trained on" } else { "the frames trained on, without their truth" };
    Ok(Evaluation {
        title: request.out.display().to_string(),
        data: format!("{}: {} sequences, {frames} frames, {kind}", evaluated.name(), sequences.len()),
        depth: if with_depth { Some(depth.finish()?) } else { None },
        motion: if with_truth { Some(motion.finish()?) } else { None },
    })
}

/// Mean disparity map and mean motion of the training data, as far as its truth is known.
pub(super) fn means(training: &dyn Dataset) -> Result<(Option<Map>, Option<MeanMotion>)> {
    let (mut disparity, mut motions, mut maps) = (MeanDisparity::new(), Vec::new(), 0);
    for s in 0..training.sequence_count().min(MEAN_SEQUENCES) {
        let frames = dimode_autodiff::par::map_indices(training.sequence_len(s), |f| training.frame(s, f));
        let frames = frames.into_iter().collect::<Result<Vec<_>, _>>()?;
        for frame in &frames {
            if let Some(depth) = &frame.depth {
                disparity.add(depth)?;
                maps += 1;
            }
        }
        for pair in frames.windows(2) {
            if let (Some(a), Some(b)) = (pair[0].world_from_camera, pair[1].world_from_camera) {
                motions.push(b.inverse().compose(&a));
            }
        }
    }
    let disparity = if maps > 0 { Some(disparity.finish()?) } else { None };
    let motion = if motions.is_empty() { None } else { Some(MeanMotion::fit(&motions)?) };
    Ok((disparity, motion))
}

/// Trajectories of every sequence (KITTI and TUM) and the depth of its frames as 16-bit pictures (256 steps a metre).
fn write_outputs(folder: &RunFolder, sequences: &[Predicted]) -> Result<()> {
    let trajectories = folder.path().join("trajectories");
    std::fs::create_dir_all(&trajectories).map_err(|e| crate::data::DataError::write(&trajectories, e))?;
    for sequence in sequences {
        let trajectory = match &sequence.truth {
            Some(truth) => follow(&sequence.steps, truth)?,
            None => Trajectory::accumulate(&sequence.steps),
        };
        write_trajectory(&trajectories, &sequence.name, &trajectory)?;
        for (frame, depth) in sequence.frames.iter().zip(&sequence.depth) {
            let place = folder.path().join("depth").join(&sequence.name);
            std::fs::create_dir_all(&place).map_err(|e| crate::data::DataError::write(&place, e))?;
            write_depth_png16(&place.join(format!("{}.png", frame.name)), &in_metres(depth, frame.depth.as_ref()))?;
        }
    }
    Ok(())
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
    let parameters = [
        ("depth network", trained.weights.depth.parameter_count()),
        ("pose network", trained.weights.pose.parameter_count()),
        ("flow network", trained.weights.flow.parameter_count()),
    ];
    let mut facts = vec![
        ("seed".to_owned(), config.seed.to_string()),
        ("steps x batch".to_owned(), format!("{} x {}", config.train.steps, config.train.batch)),
        ("training time".to_owned(), format!("{:.0} s", seconds)),
        ("frame size".to_owned(), format!("{} x {}", config.data.width, config.data.height)),
    ];
    facts.extend(parameters.map(|(name, count)| (name.to_owned(), format!("{count} parameters"))));
    let mut begin = 0;
    let mut stage_marks = Vec::new();
    for (name, end) in Schedule::new(&config.train).ends() {
        stage_marks.push(StageMark { step: begin, label: name.to_owned() });
        begin = end;
    }
    Ok(ReportInput {
        title: format!("DiMoDE run: {}", evaluation.data),
        command: request.command.clone(),
        config_toml: config.to_toml(),
        facts,
        stage_marks,
        curves: curves(&records),
        samples: sequences.iter().take(SHOWN).filter_map(|s| picture(trained, s)).collect(),
        trajectories: sequences.iter().take(SHOWN).map(path).collect::<Result<_>>()?,
        evaluation: Some(evaluation.clone()),
        notes: vec![
            "Depth and translation of monocular video have no common scale: depth is scaled by the ratio of medians, paths are \
             aligned as named beside them."
                .to_owned(),
        ],
    })
}

fn path(sequence: &Predicted) -> Result<TrajectoryPlot> {
    let Some(truth) = &sequence.truth else {
        return Ok(TrajectoryPlot::predicted(&sequence.name, &Trajectory::accumulate(&sequence.steps)));
    };
    let predicted = follow(&sequence.steps, truth)?;
    Ok(match align_trajectory(&predicted, truth, Alignment::Sim3) {
        Ok(aligned) => TrajectoryPlot::aligned(&sequence.name, Alignment::Sim3, &aligned),
        Err(_) => TrajectoryPlot::predicted(&sequence.name, &predicted),
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

/// The middle frame of a sequence with depth, optical and rigid flow to the next frame.
fn picture(trained: &TrainedModel, sequence: &Predicted) -> Option<SamplePicture> {
    let at = (sequence.frames.len() / 2).min(sequence.steps.len().checked_sub(1)?);
    let (frame, next) = (&sequence.frames[at], &sequence.frames[at + 1]);
    let flow = trained.model.predict_flow(&trained.weights, &stack([&frame.image]), &stack([&next.image]));
    let depth = &sequence.depth[at];
    let tape = Tape::<f32>::new();
    let (rotation, translation) = taped::pose::pose_tensors(&[sequence.steps[at]]);
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
    Some(SamplePicture {
        caption: format!("sequence {}, frame {}", sequence.name, frame.name),
        image: frame.image.clone(),
        predicted_depth: depth.clone(),
        true_depth: frame.depth.clone(),
        optical_flow: Some(map(&flow)),
        rigid_flow: Some(map(&rigid)),
    })
}
