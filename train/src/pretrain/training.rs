//! The loop: batch, loss, gradients, optimiser, and now and then a look at held-out worlds.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Result;
use dimode_autodiff::{Pool, Tape, par};
use dimode_nets::{Binder, Mode, ParamGradient, ParamSet};
use serde::Serialize;

use super::settings::Settings;
use super::target::Target;
use super::task::Task;
use super::worlds::Worlds;
use crate::data::synthetic::Split;
use crate::memory::PeakMemory;
use crate::non_finite::NonFinite;
use crate::optim::adamw::{AdamW, State};
use crate::optim::{clip_scale, gradient_norm};
use crate::progress::Progress;
use crate::run::Stopped;

/// Largest gradient norm of a step.
const CLIP_NORM: f64 = 1.0;
const WEIGHT_DECAY: f64 = 1e-4;
const ADVICE: &str = "nothing was written; lower --learning-rate";

/// Mean error on held-out worlds of one kind, in pixels.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct HeldOutError {
    /// Kind of worlds.
    pub preset: String,
    /// Of the network.
    pub network: f64,
    /// Of the answer that it is compared with.
    pub zero: f64,
    /// Pairs measured.
    pub pairs: usize,
}

/// Trains the network of a task and writes its weights; returns the errors on held-out worlds.
///
/// # Errors
/// [`Stopped`] soon after `stop` is set, [`NonFinite`] when loss, gradient, weights or error is not finite, and what the system
/// refuses. Nothing is written then.
pub fn train<T: Task>(
    task: &T,
    settings: &Settings,
    target: &Target,
    progress: &dyn Progress,
    stop: &AtomicBool,
) -> Result<Vec<HeldOutError>> {
    par::inside(|| {
        let worlds = Worlds::open::<T>(settings, &settings.presets, Split::Train)?;
        let mut learner = Learner::new(task, settings);
        progress.start(settings.steps as u64, &format!("pre-training {}", T::NETWORK));
        for step in 0..settings.steps {
            go_on(stop, progress, step)?;
            let batch = task.batch(&worlds, step, settings.batch)?;
            let loss = par::awake(|| learner.step(&batch, step))?;
            progress.step(step as u64 + 1, &format!("loss {loss:.3}"));
            if (step + 1).is_multiple_of(T::LOOK_EVERY) {
                let errors = held_out_errors(task, settings, &learner.params, T::LOOK_PAIRS)?;
                let text: Vec<_> = errors.iter().map(|e| format!("{} {:.3} px", e.preset, e.network)).collect();
                progress.note(&format!("step {}: {} {}", step + 1, T::MEASURE, text.join(", ")));
            }
        }
        progress.finish();
        let errors = learner.conclude()?;
        go_on(stop, progress, settings.steps)?;
        target.write(&learner.params)?;
        progress.note(&format!("peak memory of pre-training: {}", PeakMemory::now(learner.pool.peak_bytes())));
        Ok(errors)
    })
}

fn go_on(stop: &AtomicBool, progress: &dyn Progress, steps: usize) -> Result<(), Stopped> {
    if stop.load(Ordering::Relaxed) {
        progress.note(&format!("stopped after step {steps}; nothing was written"));
        return Err(Stopped);
    }
    Ok(())
}

/// A network while it learns.
struct Learner<'a, T> {
    task: &'a T,
    settings: &'a Settings,
    params: ParamSet<f32>,
    optimiser: AdamW,
    state: State,
    pool: Arc<Pool<f32>>,
}

impl<'a, T: Task> Learner<'a, T> {
    fn new(task: &'a T, settings: &'a Settings) -> Self {
        Learner {
            task,
            settings,
            params: task.init(settings.seed),
            optimiser: AdamW { weight_decay: WEIGHT_DECAY, ..AdamW::default() },
            state: State::default(),
            pool: Pool::new(),
        }
    }

    /// Takes a step, counted from 0, and gives the loss before it.
    fn step(&mut self, batch: &T::Batch, step: usize) -> Result<f64, NonFinite> {
        let tape = Tape::with_pool(self.pool.clone());
        let mut binder = Binder::new(&tape, &self.params, Mode::Train);
        let loss = self.task.loss(&mut binder, batch);
        let value = f64::from(loss.value().item());
        finite(value, step + 1, "value", || format!("the {} loss", T::NETWORK))?;
        let gradients = binder.gradients(&tape.backward_and_free(loss));
        let statistics = binder.into_statistics();
        let norm = gradient_norm(&gradients);
        finite(norm, step + 1, "gradient", weights_of::<T>)?;
        // The tape shares the weights, which change in place when it is gone.
        drop(tape);
        self.update(gradients, self.settings.learning_rate(step), clip_scale(norm, CLIP_NORM));
        self.params.apply_statistics(&statistics);
        Ok(value)
    }

    fn update(&mut self, gradients: Vec<ParamGradient<f32>>, rate: f64, scale: f64) {
        for gradient in gradients {
            let value = self.params.get_mut(&gradient.path).expect("a bound parameter").data_mut();
            self.optimiser.step(&mut self.state, &gradient.path, value, &gradient.gradient, rate, scale);
        }
    }

    /// The errors after the last step, which has no later one to show that its weights are of no use.
    fn conclude(&self) -> Result<Vec<HeldOutError>> {
        let steps = self.settings.steps;
        for (_, entry) in self.params.iter() {
            for &weight in entry.tensor().data() {
                finite(weight.into(), steps, "value", weights_of::<T>)?;
            }
        }
        let errors = held_out_errors(self.task, self.settings, &self.params, T::FINAL_PAIRS)?;
        for error in &errors {
            finite(error.network, steps, "value", || format!("the {} on held-out {} worlds", T::MEASURE, error.preset))?;
        }
        Ok(errors)
    }
}

fn finite(value: f64, step: usize, what: &'static str, of: impl Fn() -> String) -> Result<(), NonFinite> {
    if value.is_finite() {
        return Ok(());
    }
    Err(NonFinite { step: step as u64, what, term: of(), samples: Vec::new(), advice: ADVICE })
}

fn weights_of<T: Task>() -> String {
    format!("the {} network's weights", T::NETWORK)
}

/// Errors on held-out worlds, `pairs` of each kind.
fn held_out_errors<T: Task>(task: &T, settings: &Settings, params: &ParamSet<f32>, pairs: usize) -> Result<Vec<HeldOutError>> {
    let of_kind = |preset| {
        let worlds = Worlds::open::<T>(settings, &[preset], Split::HeldOut)?;
        let [network, zero] = task.errors(params, &task.batch(&worlds, 0, pairs)?);
        Ok(HeldOutError { preset: preset.to_string(), network, zero, pairs })
    };
    settings.presets.iter().copied().map(of_kind).collect()
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use dimode_autodiff::{Shape, Tensor, Var};
    use dimode_nets::{Entry, Kind, weights};

    use super::*;
    use crate::pretrain::Form;
    use crate::progress::Recorder;

    /// One weight, 0 at first, whose loss is the product of it and all factors.
    #[derive(Clone, Debug)]
    struct Slope {
        factors: [Vec<f32>; 2],
        error: f64,
    }

    impl Slope {
        fn new() -> Self {
            Slope { factors: [vec![1.0], vec![1.0]], error: 0.5 }
        }

        fn train(&self, settings: &Settings, out: &Path, stop: bool) -> (Result<Vec<HeldOutError>>, Vec<String>) {
            let (recorder, target) = (Recorder::default(), Target::new(out, Self::FORM, false).unwrap());
            let trained = train(self, settings, &target, &recorder, &AtomicBool::new(stop));
            (trained, recorder.lines())
        }
    }

    impl Task for Slope {
        /// Number of the step.
        type Batch = usize;

        const NETWORK: &'static str = "slope";
        const FORM: Form = Form::File("net");
        const MEASURE: &'static str = "distance";
        const BASELINE: &'static str = "nothing";
        const STREAM: u64 = 0;
        const STEPS: usize = 2;
        const BATCH: usize = 1;
        const LOOK_EVERY: usize = 2;
        const LOOK_PAIRS: usize = 3;
        const FINAL_PAIRS: usize = 4;

        fn init(&self, _seed: u64) -> ParamSet<f32> {
            let mut set = ParamSet::new();
            let zero = Entry::new(vec![1], Kind::Parameter, Tensor::zeros(Shape::new(1, 1, 1, 1)));
            set.file_mut("net").insert("weight", zero);
            set
        }

        fn batch(&self, _worlds: &Worlds, step: usize, _pairs: usize) -> Result<usize> {
            Ok(step)
        }

        fn loss<'t>(&self, binder: &mut Binder<'t, f32>, step: &usize) -> Var<'t, f32> {
            let (tape, weight) = (binder.tape(), binder.param("net:weight"));
            let constant = |&factor: &f32| tape.constant(Tensor::full(weight.shape(), factor));
            self.factors[*step].iter().map(constant).fold(weight, |product, factor| product.mul(factor)).sum()
        }

        fn errors(&self, _params: &ParamSet<f32>, _batch: &usize) -> [f64; 2] {
            [self.error, 1.0]
        }
    }

    #[test]
    fn a_training_tells_its_steps_and_writes_the_weights() {
        let place = tempfile::tempdir().unwrap();
        let out = place.path().join("weights");
        let (trained, lines) = Slope::new().train(&Settings::new(2, 1), &out, false);
        let error = |preset: &str| HeldOutError { preset: preset.to_owned(), network: 0.5, zero: 1.0, pairs: 4 };
        assert_eq!(trained.unwrap(), ["street", "handheld", "lateral"].map(error));
        let (peak, lines) = (&lines[5], [&lines[..5], &lines[6..]].concat());
        assert!(peak.starts_with("peak memory of pre-training: "), "{peak}");
        let look = "step 2: distance street 0.500 px, handheld 0.500 px, lateral 0.500 px";
        assert_eq!(lines, ["start pre-training slope 2", "step 1 loss 0.000", "step 2 loss -0.001", look, "finish"]);
        assert!(weights::read(&out).unwrap()[0].values[0] < 0.0);
    }

    #[test]
    fn what_is_not_finite_is_named_and_not_written() {
        let usual = Settings::new(2, 1);
        let value = Slope { factors: [vec![1.0], vec![f32::NAN]], ..Slope::new() };
        let gradient = Slope { factors: [vec![1e30, 1e30], vec![1.0]], ..Slope::new() };
        let error = Slope { error: f64::NAN, ..Slope::new() };
        let fast = Settings { learning_rate: 1e39, steps: 1, ..usual.clone() };
        for (task, settings, told) in [
            (value, &usual, "step 2: the value of the slope loss is not finite"),
            (gradient, &usual, "step 1: the gradient of the slope network's weights is not finite"),
            (Slope::new(), &fast, "step 1: the value of the slope network's weights is not finite"),
            (error, &usual, "step 2: the value of the distance on held-out street worlds is not finite"),
        ] {
            let place = tempfile::tempdir().unwrap();
            let (trained, _) = task.train(settings, &place.path().join("new/weights"), false);
            let broken = trained.unwrap_err().downcast::<NonFinite>().unwrap();
            assert_eq!(broken.to_string(), format!("{told}; nothing was written; lower --learning-rate"));
            assert_eq!(std::fs::read_dir(place.path()).unwrap().count(), 0, "{told}");
        }
    }

    #[test]
    fn a_stopped_training_writes_nothing() {
        let place = tempfile::tempdir().unwrap();
        let (trained, lines) = Slope::new().train(&Settings::new(2, 1), &place.path().join("weights"), true);
        assert!(trained.unwrap_err().is::<Stopped>());
        assert_eq!(lines[1], "stopped after step 0; nothing was written");
        assert_eq!(std::fs::read_dir(place.path()).unwrap().count(), 0);
    }
}
