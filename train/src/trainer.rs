//! One training step, read from top to bottom: networks, losses, gradients, optimiser.
//!
//! The networks are recorded on one tape and the losses on another whose leaves are the networks' outputs. The gradients of the
//! second tape's leaves are what the losses say about depth, rotation and translation; they are measured there, term by term,
//! and then carried through the networks.

use std::sync::Arc;

use dimode_autodiff::{Pool, Tape, Tensor, par};
use dimode_geometry::Se3;
use dimode_nets::{Binder, Mode, ParamGradient, ParamSet, StatisticsUpdate};

use crate::batch::{Batch, join};
use crate::config::{Config, StageConfig};
use crate::model::{Model, Weights};
use crate::non_finite::{Failure, NonFinite};
use crate::objective::{self, Given, Outputs, TermReport};
use crate::observed::ObservedFlow;
use crate::optim::adamw::{AdamW, State};
use crate::optim::{clip_scale, gradient_norm};
use crate::pose_refinement::Pairs;

/// What a step did.
#[derive(Clone, Debug, PartialEq)]
pub struct StepReport {
    /// Weighted sum of the terms.
    pub total: f64,
    /// The terms in order.
    pub terms: Vec<TermReport>,
    /// Gradient norm of each trained network before clipping: depth, pose, flow.
    pub network_gradients: [Option<f64>; 3],
}

/// Networks, weights and optimiser of a run.
pub struct Trainer {
    /// The networks.
    pub model: Model,
    /// Their weights.
    pub weights: Weights,
    /// Moments of the optimiser.
    pub optimiser: State,
    config: Config,
    pool: Arc<Pool<f32>>,
}

impl Trainer {
    /// A trainer that starts from the given weights.
    pub fn new(config: &Config, weights: Weights, optimiser: State) -> Self {
        Trainer { model: Model::new(&config.nets), weights, optimiser, config: config.clone(), pool: Pool::new() }
    }

    /// Takes one step at the given learning rate. With `probe` each term's gradient is measured apart.
    ///
    /// `observed` is the flow that [`ObservedFlow`] holds for this batch; it is found here when it is not given and needed.
    ///
    /// # Errors
    /// When a loss term, a gradient or an updated weight is not finite; nothing has changed then.
    pub fn step(
        &mut self,
        batch: &Batch,
        observed: Option<&Tensor<f32>>,
        stage: &StageConfig,
        step: u64,
        rate: f64,
        probe: bool,
    ) -> Result<StepReport, NonFinite> {
        let shared = &*self;
        let (scene, flow) = par::join(
            || shared.scene_gradients(batch, stage, observed, step, probe),
            || stage.train_flow.then(|| shared.flow_gradients(batch)),
        );
        let Scene { mut terms, mut total, depth: depth_gradients, pose: pose_gradients, statistics } =
            scene.map_err(|failure| failure.at(step, batch))?;
        let mut flow_step = None;
        if let Some(flow) = flow {
            let (term, gradients) = flow.map_err(|failure| failure.at(step, batch))?;
            total += term.weight * term.value;
            terms.push(term);
            flow_step = Some(gradients);
        }
        let clip = self.config.train.clip_norm;
        let norms = [
            stage.train_depth.then(|| gradient_norm(&depth_gradients)),
            stage.train_pose.then(|| gradient_norm(&pose_gradients)),
            flow_step.as_ref().map(|g| gradient_norm(g)),
        ];
        for (norm, name) in norms.iter().zip(["depth network", "pose network", "flow network"]) {
            if norm.is_some_and(|n| !n.is_finite()) {
                let term = format!("the {name}'s weights");
                return Err(Failure { what: "gradient", term, sample: None }.at(step, batch));
            }
        }
        let adamw = self.adamw();
        let (mut weights, mut optimiser) = (self.weights.clone(), self.optimiser.clone());
        let sets = [&mut weights.depth, &mut weights.pose, &mut weights.flow];
        let gradients = [depth_gradients, pose_gradients, flow_step.unwrap_or_default()];
        for (k, ((set, gradients), name)) in sets.into_iter().zip(gradients).zip(["depth", "pose", "flow"]).enumerate() {
            let scale = clip_scale(norms[k].unwrap_or(0.0), clip);
            let rate = rate * [1.0, self.config.train.pose_rate, self.config.loss.flow.rate][k];
            update(&adamw, &mut optimiser, set, name, gradients, rate, scale);
        }
        weights.depth.apply_statistics(&statistics[0]);
        weights.pose.apply_statistics(&statistics[1]);
        match without_finite_square(&weights) {
            Some(failure) => return Err(failure.at(step, batch)),
            None => (self.weights, self.optimiser) = (weights, optimiser),
        }
        Ok(StepReport { total, terms, network_gradients: norms })
    }

    /// Looks whether the weights can be used outside training: what they say about the batch of `step`, as an evaluation would
    /// ask them, is finite.
    ///
    /// # Errors
    /// When a depth or a motion is not.
    pub fn check_predictions(&self, batch: &Batch, step: u64) -> Result<(), NonFinite> {
        let (target, source) = (&batch.plain.target, &batch.plain.next);
        let fail = |term: &str| Err(Failure { what: "value", term: term.to_owned(), sample: None }.at(step, batch));
        let depth = self.model.predict_depth(&self.weights, target);
        if !depth.data().iter().all(|z| z.is_finite()) {
            return fail("the predicted depth");
        }
        let pairs = Pairs { target, source, earlier: 0, depth: Some(&depth), cameras: &batch.intrinsics };
        let motions = self.model.motions(&self.weights.pose, Mode::Eval, &pairs, self.config.nets.pose_test_iterations);
        let is_finite = |m: &Se3| m.rotation.iter().chain(&m.translation).all(|x| x.is_finite());
        if motions.iter().all(is_finite) { Ok(()) } else { fail("the predicted motion") }
    }

    /// Buffers that steps share.
    pub fn pool(&self) -> &Arc<Pool<f32>> {
        &self.pool
    }

    fn adamw(&self) -> AdamW {
        let train = &self.config.train;
        AdamW { betas: train.betas, epsilon: train.epsilon, weight_decay: train.weight_decay }
    }

    /// Losses of depth and motion, and the gradients of their networks' weights.
    fn scene_gradients(
        &self,
        batch: &Batch,
        stage: &StageConfig,
        observed: Option<&Tensor<f32>>,
        step: u64,
        probe: bool,
    ) -> Result<Scene, Failure> {
        let found;
        let flow = match observed {
            None if objective::needs_flow(&self.config.loss, stage) => {
                found = ObservedFlow::default().of(&self.model, &self.weights.flow, batch, &self.pool);
                Some(&found)
            }
            given => given,
        };
        let tape = Tape::with_pool(self.pool.clone());
        let mut depth = binder(&tape, &self.weights.depth, stage.train_depth);
        let mut pose = binder(&tape, &self.weights.pose, stage.train_pose);
        let outputs = self.run_networks(&tape, batch, stage, &mut depth, &mut pose);
        let losses =
            objective::measure(&self.config, self.model.range, &self.pool, &outputs, &Given { batch, stage, flow, step, probe })?;
        let gradients = tape.backward_and_free(outputs.carry(&losses.gradients));
        Ok(Scene {
            terms: losses.terms,
            total: losses.total,
            depth: if stage.train_depth { depth.gradients(&gradients) } else { Vec::new() },
            pose: if stage.train_pose { pose.gradients(&gradients) } else { Vec::new() },
            statistics: [depth.into_statistics(), pose.into_statistics()],
        })
    }

    fn run_networks<'t>(
        &self,
        tape: &'t Tape<f32>,
        batch: &Batch,
        stage: &StageConfig,
        depth: &mut Binder<'t, f32>,
        pose: &mut Binder<'t, f32>,
    ) -> Outputs<'t> {
        let images = &batch.seen;
        let n = batch.names.len();
        let with_sources = objective::needs_source_depth(stage);
        let detached = self.config.loss.geometric.detach_source_depth;
        let together = with_sources && !detached;
        let seen = if together { join(&[&images.target, &images.previous, &images.next]) } else { images.target.clone() };
        let disparities = self.model.depth.forward(depth, tape.constant(seen));
        let sources = with_sources.then(|| match together {
            true => disparities[0].slice(0, n, 2 * n),
            false => tape.constant(self.source_disparity(batch, stage.train_depth)),
        });
        let targets: Vec<_> = disparities.iter().take(self.config.loss.scales).map(|d| d.slice(0, 0, n)).collect();
        let depth = self.model.range.depth_values(&targets[0].value());
        let pairs = Pairs {
            target: &join(&[&images.target, &images.target]),
            source: &join(&[&images.previous, &images.next]),
            earlier: n,
            depth: Some(&join(&[&depth, &depth])),
            cameras: &[&batch.intrinsics[..], &batch.intrinsics[..]].concat(),
        };
        let motion = self.model.source_from_target(pose, &pairs, self.config.nets.pose_iterations);
        Outputs { disparities: targets, source_disparity: sources, motion }
    }

    /// Disparities of the sources, previous ones first, `[2 n, 1, h, w]`: values only, on a tape that is gone afterwards.
    fn source_disparity(&self, batch: &Batch, train: bool) -> Tensor<f32> {
        let images = join(&[&batch.seen.previous, &batch.seen.next]);
        let tape = Tape::with_pool(self.pool.clone());
        let mut net = Binder::selective(&tape, &self.weights.depth, if train { Mode::Train } else { Mode::Eval }, |_| false);
        self.model.depth.forward(&mut net, tape.constant(images))[0].value()
    }

    /// Loss of the flow network on some pairs of the batch, and the gradients of its weights.
    fn flow_gradients(&self, batch: &Batch) -> Result<(TermReport, Vec<ParamGradient<f32>>), Failure> {
        let tape = Tape::with_pool(self.pool.clone());
        let net = Binder::new(&tape, &self.weights.flow, Mode::Train);
        let settings = &self.config.loss.flow;
        let pairs = settings.pairs.min(batch.names.len());
        let part = |x: &Tensor<f32>| tape.constant(x.clone()).slice(0, 0, pairs);
        let (target, next) = (part(&batch.plain.target), part(&batch.plain.next));
        let flows = self.model.flow.forward(&net, target, next, self.model.flow_iterations);
        let loss = crate::losses::flow_photometric::flow_photometric(&flows, target, next, settings.smoothness);
        let value = f64::from(loss.value().item());
        let term = TermReport { name: "l_flow".into(), weight: 1.0, value, valid: 1.0, gradients: None };
        if !value.is_finite() {
            return Err(Failure { what: "value", term: term.name, sample: None });
        }
        Ok((term, net.gradients(&tape.backward_and_free(loss))))
    }
}

/// What the losses of depth and motion say.
struct Scene {
    terms: Vec<TermReport>,
    total: f64,
    depth: Vec<ParamGradient<f32>>,
    pose: Vec<ParamGradient<f32>>,
    statistics: [Vec<StatisticsUpdate<f32>>; 2],
}

fn binder<'t>(tape: &'t Tape<f32>, params: &ParamSet<f32>, train: bool) -> Binder<'t, f32> {
    if train { Binder::new(tape, params, Mode::Train) } else { Binder::frozen(tape, params) }
}

/// Steps every parameter of one network.
fn update(
    optimiser: &AdamW,
    state: &mut State,
    set: &mut ParamSet<f32>,
    network: &str,
    gradients: Vec<ParamGradient<f32>>,
    rate: f64,
    scale: f64,
) {
    for gradient in gradients {
        let value = set.get(&gradient.path).expect("a bound parameter").tensor().clone();
        let key = format!("{network}/{}", gradient.path);
        let next = optimiser.step(state, &key, &value, &gradient.gradient, rate, scale);
        set.set(&gradient.path, next);
    }
}

/// The first weight or running statistic whose square is not finite: nothing can be computed with it.
fn without_finite_square(weights: &Weights) -> Option<Failure> {
    let sets = [("depth", &weights.depth), ("pose", &weights.pose), ("flow", &weights.flow)];
    sets.into_iter().find_map(|(network, set)| {
        let bad = |tensor: &Tensor<f32>| tensor.data().iter().any(|value| !(value * value).is_finite());
        let (path, _) = set.iter().find(|(_, entry)| bad(entry.tensor()))?;
        Some(Failure { what: "square", term: format!("the updated weight {network}/{path}"), sample: None })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::NetsConfig;
    use crate::data::Dataset;
    use crate::run::trained::weight_tensors;
    use crate::run::training_frames;

    struct Setting {
        config: Config,
        frames: Box<dyn Dataset>,
    }

    impl Setting {
        fn new() -> Self {
            let mut config = Config::default();
            (config.data.width, config.data.height, config.data.worlds) = (64, 64, 1);
            config.nets = NetsConfig { rotation_scale: 500.0, tangential_scale: 100.0, ..config.nets };
            let frames = training_frames(&config).unwrap();
            Setting { config, frames }
        }

        /// What the networks say about a batch in training.
        fn motions(&self, change: impl Fn(&mut NetsConfig)) -> Vec<Se3> {
            let mut config = self.config.clone();
            change(&mut config.nets);
            let trainer = Trainer::new(&config, Model::new(&config.nets).init(3), State::default());
            let batch = Batch::load(self.frames.as_ref(), &[(0, 1)], &config.train, 1, 0).unwrap();
            let tape = Tape::new();
            let [mut depth, mut pose] = [&trainer.weights.depth, &trainer.weights.pose].map(|set| binder(&tape, set, true));
            trainer.run_networks(&tape, &batch, &config.train.stages[0], &mut depth, &mut pose).motion.to_se3()
        }
    }

    #[test]
    fn training_looks_as_often_as_its_own_setting_says() {
        let setting = Setting::new();
        let looks = [1, 2, 3].map(|k| setting.motions(|nets| nets.pose_iterations = k));
        assert!(looks[0] != looks[1] && looks[1] != looks[2], "the looks say nothing");
        for (k, said) in looks.iter().enumerate() {
            let with_test = |nets: &mut NetsConfig| (nets.pose_iterations, nets.pose_test_iterations) = (k + 1, 5);
            assert_eq!(&setting.motions(with_test), said);
        }
    }

    /// 1e25 is finite itself, 1e39 is not in f32.
    #[test]
    fn a_step_to_weights_beyond_use_changes_nothing() {
        let setting = Setting::new();
        let batch = Batch::load(setting.frames.as_ref(), &[(0, 1)], &setting.config.train, 1, 0).unwrap();
        let weights = Model::new(&setting.config.nets).init(3);
        let mut trainer = Trainer::new(&setting.config, weights.clone(), State::default());
        for rate in [1e25, 1e39] {
            let error = trainer.step(&batch, None, &setting.config.train.stages[0], 0, rate, false).unwrap_err();
            let told = error.to_string();
            assert!(told.starts_with("step 1: the square of the updated weight depth/"), "{told}");
            assert_eq!(trainer.optimiser, State::default());
            for (now, before) in weight_tensors(&trainer.weights).iter().zip(weight_tensors(&weights)) {
                assert_eq!(now.2.data(), before.2.data(), "{}", now.0);
            }
        }
    }
}
