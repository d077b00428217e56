//! Training from the first step to the report.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use dimode_autodiff::par;
use serde_json::{Map, Value, json};

use super::first_weights::load_first_weights;
use super::trained::{NamedTensor, restore_weights, weight_tensors};
use super::{RunFolder, Start, Stopped, TrainOutcome, TrainRequest, TrainedModel, checked_frames, conclude};
use crate::batch::Batch;
use crate::checkpoint::{Checkpoint, hash};
use crate::config::{Config, Decay as DecayConfig};
use crate::data::Dataset;
use crate::memory::PeakMemory;
use crate::model::{Model, Weights};
use crate::objective::{FlowWays, needs};
use crate::observed::{BatchFlow, ObservedFlow};
use crate::optim::adamw::{Moments, State};
use crate::optim::schedule::{Decay, learning_rate};
use crate::progress::Progress;
use crate::runlog::{RunLog, StepRecord};
use crate::sampler::Sampler;
use crate::schedule::Schedule;
use crate::teacher::Teacher;
use crate::trainer::{StepReport, Trainer};

/// Steps between measurements of each term's gradient.
const PROBE_EVERY: u64 = 25;

/// Trains as requested, evaluates on data that was not trained on, writes the report.
///
/// Stops after a complete step when `stop` is set, or soon in the evaluation; a checkpoint is written then.
///
/// # Errors
/// When the settings cannot work, the folder cannot be used, data cannot be read, files cannot be written, the checkpoint does
/// not fit the configuration: before the first step then, if it can be known, and no new run is left behind. When a loss, a
/// gradient, a weight or a prediction is not finite ([`crate::non_finite::NonFinite`]): the last checkpoint stays then.
pub fn train(request: &TrainRequest, progress: &dyn Progress, stop: &AtomicBool) -> Result<TrainOutcome> {
    let request = TrainRequest { config: request.config.clone().with_absolute_paths(), ..request.clone() };
    par::inside(|| run(&request, progress, stop))
}

fn run(request: &TrainRequest, progress: &dyn Progress, stop: &AtomicBool) -> Result<TrainOutcome> {
    let config = &request.config;
    let Begun { folder, dataset, mut trainer, mut log, mut step, notes } = begin(request)?;
    notes.iter().for_each(|note| progress.note(note));
    let lengths: Vec<usize> = (0..dataset.sequence_count()).map(|s| dataset.sequence_len(s)).collect();
    let mut sampler = Sampler::new(lengths, config.seed, config.train.batch);
    let schedule = Schedule::new(&config.train);
    let steps = config.train.steps;
    let teacher = Teacher::new(config);
    let pool = trainer.pool().clone();
    let load = |items: Vec<(usize, usize)>, step| {
        Batch::load(dataset.as_ref(), &items, (&config.train, &teacher), config.seed, step, &pool)
    };
    let observed = ObservedFlow::default();
    let mut prepared = None;
    let mut memory = PeakMemory::now(0);
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
        let (_, next_stage) = schedule.stage(step + 1);
        let ways = needs(&config.loss, next_stage).flow;
        let early = !stage.train_flow && !next_stage.train_flow && ways != FlowWays::None;
        let flow_network = early.then(|| (trainer.model.clone(), trainer.weights().flow.clone(), trainer.pool().clone()));
        let load_next = || -> Result<Option<Prepared>> {
            let Some(items) = next else { return Ok(None) };
            let batch = load(items, step + 1)?;
            let both_ways = ways == FlowWays::Both;
            let flow = flow_network.map(|(model, weights, pool)| observed.of((&model, &weights), &batch, both_ways, &pool));
            Ok(Some(Prepared { batch, flow }))
        };
        // Awake around both: a step that wakes the other threads itself would first let them end the loading.
        let (report, upcoming) =
            par::awake(|| par::join(|| trainer.step(&batch, flow.as_ref(), stage, step, rate, probe), load_next));
        // After an error the weights of now lead here again; those of the last checkpoint, which stays, may not.
        let place = || folder.path().display().to_string();
        let report = report.with_context(place)?;
        prepared = upcoming?;
        step += 1;
        memory = PeakMemory::now(trainer.pool().peak_bytes());
        let measured = (began.elapsed().as_secs_f64(), memory);
        log.append(&record(step, &stage.name, &report, rate, measured))?;
        progress.step(step, &message(&report));
        let stopping = stop.load(Ordering::Relaxed);
        if stopping || step == steps || step.is_multiple_of(config.train.checkpoint_every) {
            log.sync()?;
            trainer.check_predictions(&batch, step - 1).with_context(place)?;
            save(&trainer, step).write(&folder.checkpoint())?;
        }
        if stopping && step < steps {
            return Ok(TrainOutcome::Interrupted { step });
        }
    }
    progress.finish();
    progress.note(&format!("peak memory of training: {memory}"));
    let (model, weights) = trainer.into_networks();
    let trained = TrainedModel { config: config.clone(), model, weights };
    finish(request, &folder, dataset.as_ref(), &trained, progress, stop)
}

/// A batch that was made while the step before it was taken.
struct Prepared {
    batch: Batch,
    flow: Option<BatchFlow>,
}

/// A run that has a checkpoint.
struct Begun {
    folder: RunFolder,
    dataset: Box<dyn Dataset>,
    trainer: Trainer,
    log: RunLog,
    /// Steps done.
    step: u64,
    /// What the user should know of the first weights.
    notes: Vec<String>,
}

/// Checks what can be known before the first step, then goes on from the checkpoint or makes a folder that has one.
fn begin(request: &TrainRequest) -> Result<Begun> {
    let config = &request.config;
    config.validate()?;
    let dataset = checked_frames(config)?;
    Teacher::new(config).check(dataset.as_ref())?;
    if request.start == Start::Resume {
        let folder = RunFolder::open(&request.out)?;
        let (trainer, step) = restore(config, &folder.checkpoint())?;
        let log = RunLog::resume(&folder.log(), step)?;
        return Ok(Begun { folder, dataset, trainer, log, step, notes: Vec::new() });
    }
    let mut weights = Model::of(config).init(config.seed);
    let notes = load_first_weights(&config.nets, &mut weights)?;
    let trainer = Trainer::new(config, weights, State::default());
    let folder = RunFolder::create(&request.out, config, &request.command, request.start == Start::Replace)?;
    let first_files = || -> Result<RunLog> {
        let log = RunLog::create(&folder.log())?;
        save(&trainer, 0).write(&folder.checkpoint())?;
        Ok(log)
    };
    let log = first_files().inspect_err(|_| folder.give_up())?;
    Ok(Begun { folder, dataset, trainer, log, step: 0, notes })
}

/// The networks of a checkpoint, and the number of steps done.
fn restore(config: &Config, path: &Path) -> Result<(Trainer, u64)> {
    let mut weights = Model::of(config).init(config.seed);
    let checkpoint = Checkpoint::read(path)?;
    restore_weights(&mut weights, &checkpoint.tensors, path)?;
    let step = checkpoint.state["step"].as_u64().with_context(|| format!("{}: no step", path.display()))?;
    if step > config.train.steps {
        bail!("{}: is at step {step}, beyond the {} steps asked for", path.display(), config.train.steps);
    }
    let optimiser = restore_moments(&checkpoint).with_context(|| path.display().to_string())?;
    Ok((Trainer::new(config, weights, optimiser), step))
}

/// Everything that the next step depends on.
fn save(trainer: &Trainer, step: u64) -> Checkpoint {
    let mut tensors = weight_tensors(trainer.weights());
    let dims: Vec<(String, Vec<usize>)> = tensors.iter().map(|t| (t.0.clone(), t.1.clone())).collect();
    let mut taken = Map::new();
    for (path, dims) in dims {
        if let Some(moments) = trainer.optimiser().0.get(&path) {
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

fn record(step: u64, stage: &str, report: &StepReport, rate: f64, (seconds, memory): (f64, PeakMemory)) -> StepRecord {
    let mut record = StepRecord { step, stage: stage.to_owned(), learning_rate: rate, seconds, memory, ..StepRecord::default() };
    record.terms.insert("total".into(), report.total);
    for term in &report.terms {
        record.terms.insert(term.name.clone(), term.value);
        record.valid.insert(term.name.clone(), term.valid);
        if let Some(g) = term.gradients {
            if !term.images.is_empty() {
                record.images.insert(term.name.clone(), term.images.clone());
            }
            let parts = [
                ("disparity", g.disparity),
                ("depth", g.depth),
                ("rotation", g.rotation),
                ("t_tan", g.tangential),
                ("t_rad", g.radial),
            ];
            for (part, norm) in parts {
                record.gradient_norms.insert(format!("{}/{part}", term.name), norm);
            }
        }
    }
    for (norm, network) in report.network_gradients.iter().zip(Weights::NAMES) {
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
