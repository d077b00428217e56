//! One training step, read from top to bottom: networks, losses, gradients, optimiser.
//!
//! The networks are recorded on two tapes, depth on one, what moves on the other, so that they run side by side. The losses are
//! recorded on a third one whose leaves are the networks' outputs. The gradients of its leaves are what the losses say about
//! depth, rotation and translation; they are measured there, term by term, and then carried through the networks.

mod networks;

use std::collections::BTreeMap;
use std::sync::Arc;

use dimode_autodiff::{Pool, Tape, Tensor, par};
use dimode_geometry::Se3;
use dimode_nets::{Binder, Kind, Mode, ParamGradient, ParamSet, StatisticsUpdate};

use crate::batch::{Batch, join_in};
use crate::config::{Config, StageConfig};
use crate::model::{Model, Weights};
use crate::non_finite::{Failure, NonFinite};
use crate::objective::{self, FlowWays, Given, LossReport, Outputs, TermReport};
use crate::observed::BatchFlow;
use crate::optim::adamw::{AdamW, Largest, State, has_finite_squares};
use crate::optim::{clip_scale, gradient_norm};
use crate::pose_refinement::Pairs;
use networks::binder;

/// What a step did.
#[derive(Clone, Debug, PartialEq)]
pub struct StepReport {
    /// Weighted sum of the terms.
    pub total: f64,
    /// The terms in order.
    pub terms: Vec<TermReport>,
    /// Gradient norm of each trained network before clipping, in the order of [`Weights::NAMES`].
    pub network_gradients: [Option<f64>; 4],
}

/// Networks, weights and optimiser of a run.
pub struct Trainer {
    /// The networks.
    pub model: Model,
    weights: Weights,
    optimiser: State,
    /// Sizes of parameters that this trainer has stepped, by the optimiser's name of them.
    largest: BTreeMap<String, Largest>,
    config: Config,
    pool: Arc<Pool<f32>>,
}

impl Trainer {
    /// A trainer that starts from the given weights.
    pub fn new(config: &Config, weights: Weights, optimiser: State) -> Self {
        let (largest, pool) = (BTreeMap::new(), Pool::new());
        Trainer { model: Model::of(config), weights, optimiser, largest, config: config.clone(), pool }
    }

    /// The weights of the networks.
    pub fn weights(&self) -> &Weights {
        &self.weights
    }

    /// The networks with their weights.
    pub fn into_networks(self) -> (Model, Weights) {
        (self.model, self.weights)
    }

    /// Moments of the optimiser.
    pub fn optimiser(&self) -> &State {
        &self.optimiser
    }

    /// Takes one step at the given learning rate. With `probe` each term's gradient is measured apart.
    ///
    /// `observed` is the flow that [`ObservedFlow`](crate::observed::ObservedFlow) holds for this batch; it is found here when it is
    /// not given and needed.
    ///
    /// # Errors
    /// When a loss term, a gradient or an updated weight is not finite; nothing has changed then.
    pub fn step(
        &mut self,
        batch: &Batch,
        observed: Option<&BatchFlow>,
        stage: &StageConfig,
        step: u64,
        rate: f64,
        probe: bool,
    ) -> Result<StepReport, NonFinite> {
        par::awake(|| self.step_awake(batch, observed, stage, (step, rate, probe)))
    }

    /// [`Trainer::step`] on threads that stay awake.
    fn step_awake(
        &mut self,
        batch: &Batch,
        observed: Option<&BatchFlow>,
        stage: &StageConfig,
        (step, rate, probe): (u64, f64, bool),
    ) -> Result<StepReport, NonFinite> {
        let shared = &*self;
        let (scene, flow) = par::join(
            || shared.scene_gradients(batch, stage, observed, step, probe),
            || stage.train_flow.then(|| shared.flow_gradients(batch)),
        );
        let Scene { losses: LossReport { mut terms, mut total }, gradients, statistics } =
            scene.map_err(|failure| failure.at(step, batch))?;
        let [depth_gradients, pose_gradients, flow_of_scene, rectify_gradients] = gradients;
        let mut flow_step = None;
        if let Some(flow) = flow {
            let (own, gradients) = flow.map_err(|failure| failure.at(step, batch))?;
            total += own.iter().map(|term| term.weight * term.value).sum::<f64>();
            terms.extend(own);
            flow_step = Some(added(gradients, flow_of_scene));
        }
        let clip = self.config.train.clip_norm;
        let norms = [
            stage.train_depth.then(|| gradient_norm(&depth_gradients)),
            stage.train_pose.then(|| gradient_norm(&pose_gradients)),
            flow_step.as_ref().map(|g| gradient_norm(g)),
            self.trains_rectify(stage).then(|| gradient_norm(&rectify_gradients)),
        ];
        for (norm, name) in norms.iter().zip(Weights::NAMES) {
            if norm.is_some_and(|n| !n.is_finite()) {
                let term = format!("the {name} network's weights");
                return Err(Failure { what: "gradient", term, sample: None }.at(step, batch));
            }
        }
        let gradients = [depth_gradients, pose_gradients, flow_step.unwrap_or_default(), rectify_gradients];
        let rates = [1.0, self.config.train.pose_rate, self.config.loss.flow.rate, 1.0].map(|share| rate * share);
        let paces = std::array::from_fn(|k| {
            let norm = norms[k].unwrap_or(0.0);
            let scale = clip_scale(norm, clip);
            Pace { rate: rates[k], scale, bound: norm * scale }
        });
        self.update(&gradients, &statistics, paces).map_err(|failure| failure.at(step, batch))?;
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
        let motions = self.model.predict_motions(&self.weights, &pairs, self.config.nets.pose_test_iterations);
        let is_finite = |m: &Se3| m.rotation.iter().chain(&m.translation).all(|x| x.is_finite());
        if motions.iter().all(is_finite) { Ok(()) } else { fail("the predicted motion") }
    }

    /// Buffers that steps share.
    pub fn pool(&self) -> &Arc<Pool<f32>> {
        &self.pool
    }

    /// Steps every parameter in place, if all weights and running statistics can be used afterwards; else nothing changes.
    fn update(
        &mut self,
        gradients: &[Vec<ParamGradient<f32>>; 4],
        statistics: &[Vec<StatisticsUpdate<f32>>; 3],
        paces: [Pace; 4],
    ) -> Result<(), Failure> {
        let adamw = self.adamw();
        let before = self.weights.sets().map(buffers);
        self.weights.depth.apply_statistics(&statistics[0]);
        self.weights.pose.apply_statistics(&statistics[1]);
        self.weights.rectify.apply_statistics(&statistics[2]);
        if let Some(failure) = self.unusable(&adamw, gradients, paces) {
            for (set, before) in self.weights.sets_mut().into_iter().zip(before) {
                before.into_iter().for_each(|(path, buffer)| set.set(&path, buffer));
            }
            return Err(failure);
        }
        for (k, (network, set)) in Weights::NAMES.into_iter().zip(self.weights.sets_mut()).enumerate() {
            let Pace { rate, scale, .. } = paces[k];
            for ParamGradient { path, gradient } in &gradients[k] {
                let (key, value) = (key(network, path), set.get_mut(path).expect("a bound parameter").data_mut());
                let largest = adamw.step(&mut self.optimiser, &key, value, gradient, rate, scale);
                self.largest.insert(key, largest);
            }
        }
        Ok(())
    }

    fn adamw(&self) -> AdamW {
        let train = &self.config.train;
        AdamW { betas: train.betas, epsilon: train.epsilon, weight_decay: train.weight_decay }
    }

    /// The first weight or running statistic that nothing can be computed with after the step, because its square is not finite.
    fn unusable(&self, adamw: &AdamW, gradients: &[Vec<ParamGradient<f32>>; 4], paces: [Pace; 4]) -> Option<Failure> {
        Weights::NAMES.into_iter().zip(self.weights.sets()).enumerate().find_map(|(k, (network, set))| {
            let stepped: BTreeMap<&str, &Tensor<f32>> = gradients[k].iter().map(|g| (g.path.as_str(), &g.gradient)).collect();
            let Pace { rate, scale, bound } = paces[k];
            let surely = |key: &str| {
                let (largest, moments) = (self.largest.get(key)?, self.optimiser.0.get(key)?);
                Some(adamw.surely_keeps_usable(*largest, moments.steps, bound, rate))
            };
            let is_usable = |path: &str, value: &[f32]| match stepped.get(path) {
                Some(gradient) => {
                    let key = key(network, path);
                    surely(&key) == Some(true) || adamw.keeps_usable(&self.optimiser, &key, value, gradient, rate, scale)
                }
                None => has_finite_squares(value),
            };
            let (path, _) = set.iter().find(|(path, entry)| !is_usable(path, entry.tensor().data()))?;
            Some(Failure { what: "square", term: format!("the updated weight {network}/{path}"), sample: None })
        })
    }

    /// Losses of depth and motion, and the gradients of their networks' weights.
    fn scene_gradients(
        &self,
        batch: &Batch,
        stage: &StageConfig,
        observed: Option<&BatchFlow>,
        step: u64,
        probe: bool,
    ) -> Result<Scene, Failure> {
        let needs = objective::needs(&self.config.loss, stage);
        let draw = (self.config.seed, step);
        let [of_depth, of_motion] = [(); 2].map(|()| Tape::with_pool(self.pool.clone()));
        let mut depth = binder(&of_depth, &self.weights.depth, stage.train_depth, draw);
        let mut pose = binder(&of_motion, &self.weights.pose, stage.train_pose, draw);
        let mut flow = binder(&of_motion, &self.weights.flow, stage.train_flow, draw);
        let mut rectify = binder(&of_motion, &self.weights.rectify, stage.train_pose, draw);
        let rectified = self.model.rectify.as_ref().map(|net| self.rectified(net, &mut rectify, batch, step));
        let seen = match &rectified {
            Some(rectified) => rectified.seen.clone(),
            None => join_in(&self.pool, &[&batch.seen.previous, &batch.seen.next]),
        };
        let outputs = Outputs {
            flow: self.flow_between(&mut flow, batch, needs.flow, (stage, observed)),
            rectified: rectified.as_ref().map(|rectified| rectified.plain),
            ..self.run_networks((batch, &seen), (stage, needs), &mut depth, &mut pose)
        };
        let given = Given { batch, stage, step, probe };
        let (mut losses, of_outputs) = objective::measure(&self.config, self.model.range, &self.pool, &outputs, &given)?;
        let [to_depth, mut to_motion] = outputs.carry(&of_outputs);
        if let Some(rectified) = &rectified {
            to_motion = to_motion.add(objective::rotation::measure(&self.config.loss, rectified, &mut losses)?);
        }
        let (by_depth, by_motion) = par::join(|| of_depth.backward_and_free(to_depth), || of_motion.backward_and_free(to_motion));
        let of = |net: &Binder<'_, f32>, gradients, trained: bool| if trained { net.gradients(gradients) } else { Vec::new() };
        let reaches_flow = stage.train_flow && needs.flow != FlowWays::None;
        Ok(Scene {
            losses,
            gradients: [
                of(&depth, &by_depth, stage.train_depth),
                of(&pose, &by_motion, stage.train_pose),
                of(&flow, &by_motion, reaches_flow),
                of(&rectify, &by_motion, self.trains_rectify(stage)),
            ],
            statistics: [depth.into_statistics(), pose.into_statistics(), rectify.into_statistics()],
        })
    }

    /// Whether a stage trains the network that removes rotation: with the pose network, where there is one.
    fn trains_rectify(&self, stage: &StageConfig) -> bool {
        stage.train_pose && self.model.rectify.is_some()
    }

    /// The flow network's own terms on some pairs of the batch, and the gradients of its weights.
    fn flow_gradients(&self, batch: &Batch) -> Result<(Vec<TermReport>, Vec<ParamGradient<f32>>), Failure> {
        let tape = Tape::with_pool(self.pool.clone());
        let mut net = Binder::new(&tape, &self.weights.flow, Mode::Train);
        let settings = &self.config.loss.flow;
        let pairs = settings.pairs.min(batch.names.len());
        let part = |x: &Tensor<f32>| tape.constant(x.clone()).slice(0, 0, pairs);
        let (target, next) = (part(&batch.plain.target), part(&batch.plain.next));
        let flows = self.model.flow.forward(&mut net, target, next, self.model.flow_iterations);
        let back = objective::flow::needs_flow_back(settings)
            .then(|| self.model.flow.forward(&mut net, next, target, self.model.flow_iterations));
        let (loss, terms) = objective::flow::measure(settings, [target, next], &flows, back.as_deref())?;
        Ok((terms, net.gradients(&tape.backward_and_free(loss))))
    }
}

/// How a network is stepped.
#[derive(Clone, Copy)]
struct Pace {
    /// Learning rate.
    rate: f64,
    /// Factor on the gradient.
    scale: f64,
    /// No entry of the gradient is larger after that.
    bound: f64,
}

/// What the losses of depth and motion say.
struct Scene {
    losses: LossReport,
    /// Of the weights, in the order of [`Weights::NAMES`].
    gradients: [Vec<ParamGradient<f32>>; 4],
    /// Seen by depth, pose and rectifying network.
    statistics: [Vec<StatisticsUpdate<f32>>; 3],
}

/// The sums of two lists of gradients of one network, the second of which may be empty.
fn added(mut own: Vec<ParamGradient<f32>>, more: Vec<ParamGradient<f32>>) -> Vec<ParamGradient<f32>> {
    for (own, more) in own.iter_mut().zip(more) {
        for (a, b) in own.gradient.make_mut().iter_mut().zip(more.gradient.data()) {
            *a += b;
        }
    }
    own
}

/// Name of a parameter among the optimiser's moments, in one allocation: every step asks for all of them.
fn key(network: &str, path: &str) -> String {
    [network, "/", path].concat()
}

/// The running statistics of a network.
fn buffers(set: &ParamSet<f32>) -> Vec<(String, Tensor<f32>)> {
    let statistics = set.iter().filter(|(_, entry)| entry.kind() == Kind::Buffer);
    statistics.map(|(path, entry)| (path, entry.tensor().clone())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::NetsConfig;
    use crate::data::Dataset;
    use crate::objective::Needs;
    use crate::run::trained::weight_tensors;
    use crate::run::training_frames;
    use crate::teacher::Teacher;

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
            let batch =
                Batch::load(self.frames.as_ref(), &[(0, 1)], (&config.train, &Teacher::None), 1, 0, &Pool::new()).unwrap();
            let tape = Tape::new();
            let sources = join_in(&trainer.pool, &[&batch.seen.previous, &batch.seen.next]);
            let [mut depth, mut pose] =
                [&trainer.weights.depth, &trainer.weights.pose].map(|set| binder(&tape, set, true, (1, 0)));
            trainer
                .run_networks((&batch, &sources), (&config.train.stages[0], Needs::default()), &mut depth, &mut pose)
                .motion
                .to_se3()
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
        let batch =
            Batch::load(setting.frames.as_ref(), &[(0, 1)], (&setting.config.train, &Teacher::None), 1, 0, &Pool::new()).unwrap();
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
