//! Training from the first step to the report.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use dimode_autodiff::{Tensor, par};
use serde_json::{Map, Value, json};

use super::first_weights::load_first_weights;
use super::trained::{NamedTensor, restore_weights, weight_tensors};
use super::{RunFolder, Stopped, TrainOutcome, TrainRequest, TrainedModel, conclude, training_frames};
use crate::batch::Batch;
use crate::checkpoint::{Checkpoint, hash};
use crate::config::{Config, Decay as DecayConfig};
use crate::data::Dataset;
use crate::model::Model;
use crate::objective::needs_flow;
use crate::observed::ObservedFlow;
use crate::optim::adamw::{Moments, State};
use crate::optim::schedule::{Decay, learning_rate};
use crate::progress::Progress;
use crate::runlog::{RunLog, StepRecord};
use crate::sampler::Sampler;
use crate::schedule::Schedule;
use crate::trainer::{StepReport, Trainer};

/// Steps between measurements of each term's gradient.
const PROBE_EVERY: u64 = 25;

/// Trains as requested, evaluates on data that was not trained on, writes the report.
///
/// Stops after a complete step when `stop` is set, or soon in the evaluation; a checkpoint is written then.
///
/// # Errors
/// When data cannot be read, files cannot be written, the checkpoint does not fit the configuration, or a loss or gradient is
/// not finite ([`crate::non_finite::NonFinite`]); a checkpoint of the step before is written then.
pub fn train(request: &TrainRequest, progress: &dyn Progress, stop: &AtomicBool) -> Result<TrainOutcome> {
    par::inside(|| run(request, progress, stop))
}

fn run(request: &TrainRequest, progress: &dyn Progress, stop: &AtomicBool) -> Result<TrainOutcome> {
    let config = &request.config;
    let folder = RunFolder::new(&request.out);
    let dataset = training_frames(config)?;
    let (mut trainer, mut step) = start(request, &folder)?;
    let mut log = if request.resume { RunLog::resume(&folder.log(), step)? } else { RunLog::create(&folder.log())? };
    let lengths: Vec<usize> = (0..dataset.sequence_count()).map(|s| dataset.sequence_len(s)).collect();
    let mut sampler = Sampler::new(lengths, config.seed, config.train.batch);
    let schedule = Schedule::new(&config.train);
    let steps = config.train.steps;
    let load = |items: Vec<(usize, usize)>, step| Batch::load(dataset.as_ref(), &items, &config.train, config.seed, step);
    let observed = ObservedFlow::default();
    let mut prepared = None;
    if !request.resume {
        // From here on there is a checkpoint to go on from, whatever happens.
        save(&trainer, step).write(&folder.checkpoint()).inspect_err(|_| folder.give_up())?;
    }
    progress.start(steps, "training");
    while step < steps {
        let began = Instant::now();
        let (index, stage) = schedule.stage(step);
        if step == 0 || schedule.stage(step - 1).0 != index {
            progress.note(&format!("step {}: stage {}", step + 1, stage.name));
        }
        let Prepared { batch, flow } = match prepared.take() {
            Some(ready) => ready,
            None => Prepared { batch: load(sampler.batch(step as usize), step)?, flow: None },
        };
        if stage.train_flow {
            observed.clear();
        }
        let rate = rate_of(config, step);
        let probe = step.is_multiple_of(PROBE_EVERY);
        let next = (step + 1 < steps).then(|| sampler.batch(step as usize + 1));
        // A network that is not trained in this step or the next can already look at the next batch.
        let early = !stage.train_flow && needs_flow(&config.loss, schedule.stage(step + 1).1);
        let flow_network = early.then(|| (trainer.model.clone(), trainer.weights.flow.clone(), trainer.pool().clone()));
        let (report, upcoming) = par::join(
            || trainer.step(&batch, flow.as_ref(), stage, step, rate, probe),
            || -> Result<Option<Prepared>> {
                let Some(items) = next else { return Ok(None) };
                let batch = load(items, step + 1)?;
                let flow = flow_network.map(|(model, weights, pool)| observed.of(&model, &weights, &batch, &pool));
                Ok(Some(Prepared { batch, flow }))
            },
        );
        let report = match report {
            Ok(report) => report,
            Err(error) => {
                // The weights of now lead here again; those of the last checkpoint may not.
                log.sync()?;
                return Err(error).with_context(|| folder.path().display().to_string());
            }
        };
        prepared = upcoming?;
        step += 1;
        log.append(&record(step, &stage.name, &report, rate, began.elapsed().as_secs_f64()))?;
        progress.step(step, &message(&report));
        let stopping = stop.load(Ordering::Relaxed);
        if stopping || step == steps || step.is_multiple_of(config.train.checkpoint_every) {
            log.sync()?;
            save(&trainer, step).write(&folder.checkpoint())?;
        }
        if stopping && step < steps {
            return Ok(TrainOutcome::Interrupted { step });
        }
    }
    progress.finish();
    let Trainer { model, weights, .. } = trainer;
    let trained = TrainedModel { config: config.clone(), model, weights };
    finish(request, &folder, dataset.as_ref(), &trained, progress, stop)
}

/// A batch that was made while the step before it was taken.
struct Prepared {
    batch: Batch,
    flow: Option<Tensor<f32>>,
}

/// Fresh networks, or those of the checkpoint; and the number of steps done.
fn start(request: &TrainRequest, folder: &RunFolder) -> Result<(Trainer, u64)> {
    let config = &request.config;
    let model = Model::new(&config.nets);
    let mut weights = model.init(config.seed);
    if !request.resume {
        load_first_weights(&config.nets, &mut weights)?;
        return Ok((Trainer::new(config, weights, State::default()), 0));
    }
    let path = folder.checkpoint();
    let checkpoint = Checkpoint::read(&path)?;
    restore_weights(&mut weights, &checkpoint.tensors, &path)?;
    let step = checkpoint.state["step"].as_u64().with_context(|| format!("{}: no step", path.display()))?;
    if step > config.train.steps {
        bail!("{}: is at step {step}, beyond the {} steps asked for", path.display(), config.train.steps);
    }
    let optimiser = restore_moments(&checkpoint).with_context(|| path.display().to_string())?;
    Ok((Trainer::new(config, weights, optimiser), step))
}

/// Everything that the next step depends on.
fn save(trainer: &Trainer, step: u64) -> Checkpoint {
    let mut tensors = weight_tensors(&trainer.weights);
    let dims: Vec<(String, Vec<usize>)> = tensors.iter().map(|t| (t.0.clone(), t.1.clone())).collect();
    let mut taken = Map::new();
    for (path, dims) in dims {
        if let Some(moments) = trainer.optimiser.0.get(&path) {
            tensors.push((format!("first/{path}"), dims.clone(), moments.first.clone()));
            tensors.push((format!("second/{path}"), dims, moments.second.clone()));
            taken.insert(path, json!(moments.steps));
        }
    }
    Checkpoint { tensors, state: json!({ "step": step, "optimiser_steps": taken }) }
}

fn restore_moments(checkpoint: &Checkpoint) -> Result<State> {
    let find = |name: String| -> Result<&NamedTensor> {
        let found = checkpoint.tensors.binary_search_by(|t| t.0.as_str().cmp(&name));
        found.map(|i| &checkpoint.tensors[i]).ok().with_context(|| format!("'{name}' is missing"))
    };
    let taken = checkpoint.state["optimiser_steps"].as_object().context("no optimiser_steps")?;
    let mut state = State::default();
    for (path, steps) in taken {
        let moments = Moments {
            steps: steps.as_u64().with_context(|| format!("optimiser_steps of '{path}' is no count"))?,
            first: find(format!("first/{path}"))?.2.clone(),
            second: find(format!("second/{path}"))?.2.clone(),
        };
        state.0.insert(path.clone(), moments);
    }
    Ok(state)
}

/// Learning rate of a step.
fn rate_of(config: &Config, step: u64) -> f64 {
    let train = &config.train;
    let decay = match train.decay {
        DecayConfig::Constant => Decay::Constant,
        DecayConfig::Cosine => Decay::Cosine { final_fraction: train.final_fraction },
    };
    // A run shorter than its warm-up would never reach the full rate.
    let warmup = train.warmup.min(train.steps / 2);
    learning_rate(train.learning_rate, step as usize, train.steps as usize, warmup as usize, decay)
}

fn record(step: u64, stage: &str, report: &StepReport, rate: f64, seconds: f64) -> StepRecord {
    let mut record = StepRecord { step, stage: stage.to_owned(), learning_rate: rate, seconds, ..StepRecord::default() };
    record.terms.insert("total".into(), report.total);
    for term in &report.terms {
        record.terms.insert(term.name.clone(), term.value);
        record.valid.insert(term.name.clone(), term.valid);
        if let Some(g) = term.gradients {
            let parts = [("disparity", g.disparity), ("rotation", g.rotation), ("t_tan", g.tangential), ("t_rad", g.radial)];
            for (part, norm) in parts {
                record.gradient_norms.insert(format!("{}/{part}", term.name), norm);
            }
        }
    }
    for (norm, network) in report.network_gradients.iter().zip(["depth", "pose", "flow"]) {
        if let Some(norm) = norm {
            record.gradient_norms.insert(format!("network/{network}"), *norm);
        }
    }
    record
}

fn message(report: &StepReport) -> String {
    let terms: Vec<_> = report.terms.iter().map(|t| format!("{} {:.3}", t.name, t.value)).collect();
    format!("loss {:.3} | {}", report.total, terms.join(" "))
}

fn finish(
    request: &TrainRequest,
    folder: &RunFolder,
    dataset: &dyn Dataset,
    trained: &TrainedModel,
    progress: &dyn Progress,
    stop: &AtomicBool,
) -> Result<TrainOutcome> {
    let concluded = match conclude::conclude(request, folder, dataset, trained, progress, stop) {
        Err(error) if error.is::<Stopped>() => return Ok(TrainOutcome::Interrupted { step: request.config.train.steps }),
        other => other?,
    };
    let table = concluded.evaluation.render_table();
    let metrics: Value = serde_json::to_value(&concluded.evaluation)?;
    Ok(TrainOutcome::Finished { table, metrics, report: folder.report(), checkpoint_hash: hash(&folder.checkpoint())? })
}
