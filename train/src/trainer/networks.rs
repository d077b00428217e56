//! What the networks of a trainer say about a batch.

use dimode_autodiff::{Tape, Tensor, par, rng};
use dimode_nets::{Binder, Mode, ParamSet, RectifyNet};

use super::Trainer;
use crate::batch::{Batch, join_in};
use crate::config::StageConfig;
use crate::objective::{Flow, FlowWays, Needs, Outputs, SourceDepth};
use crate::observed::{BatchFlow, ObservedFlow};
use crate::pose_refinement::Pairs;
use crate::rectification::{RectifiedSources, rectified_sources};

/// Separates the rotations that are drawn from other random numbers of a run.
const ROTATIONS: u64 = 0x726f_7461_7465;
/// The same for what layers drop.
const DROPPED: u64 = 0x64_726f_7070;

/// The weights of a network on a tape: with gradients, batch statistics and random layers, or as they are. The last
/// argument is the seed of the run and the step.
pub(super) fn binder<'t>(tape: &'t Tape<f32>, params: &ParamSet<f32>, train: bool, (seed, step): (u64, u64)) -> Binder<'t, f32> {
    if train { Binder::new(tape, params, Mode::Train).random(seed ^ DROPPED, step) } else { Binder::frozen(tape, params) }
}

impl Trainer {
    /// Disparities and motions of a batch whose sources the networks see as `seen_sources`, and what else of it a stage needs.
    ///
    /// Depth and pose network run side by side, each on its binder's tape; further looks of the pose network wait for the depth.
    pub(super) fn run_networks<'t>(
        &self,
        (batch, seen_sources): (&Batch, &Tensor<f32>),
        (stage, needs): (&StageConfig, Needs),
        depth: &mut Binder<'t, f32>,
        pose: &mut Binder<'t, f32>,
    ) -> Outputs<'t> {
        let images = &batch.seen;
        let n = batch.names.len();
        let pairs = Pairs {
            target: &join_in(&self.pool, &[&images.target, &images.target]),
            source: seen_sources,
            earlier: n,
            depth: None,
            cameras: &[&batch.intrinsics[..], &batch.intrinsics[..]].concat(),
        };
        let together = needs.source_depth == SourceDepth::Gradient;
        let seen = if together { join_in(&self.pool, &[&images.target, seen_sources]) } else { images.target.clone() };
        let (disparities, motion) = par::join(
            || {
                let seen = depth.tape().constant(seen);
                self.model.depth.forward(depth, seen)
            },
            || self.model.first_look(pose, &pairs),
        );
        let scales = || disparities.iter().take(self.config.loss.scales);
        let source_disparities = match needs.source_depth {
            SourceDepth::None => Vec::new(),
            SourceDepth::Value => vec![depth.tape().constant(self.source_disparity(seen_sources, stage.train_depth))],
            SourceDepth::Gradient => scales().map(|d| d.slice(0, n, 2 * n)).collect(),
        };
        let targets: Vec<_> = scales().map(|d| d.slice(0, 0, n)).collect();
        let looks = self.config.nets.pose_iterations;
        let depth = (looks > 1).then(|| {
            let depth = self.model.range.depth_in(&self.pool, &targets[0].value());
            join_in(&self.pool, &[&depth, &depth])
        });
        let motion = self.model.refined(pose, &Pairs { depth: depth.as_ref(), ..pairs }, motion, looks);
        Outputs { disparities: targets, source_disparities, motion, flow: None, rectified: None }
    }

    /// Disparities of the sources, previous ones first, `[2 n, 1, h, w]`: values only, on a tape that is gone afterwards.
    fn source_disparity(&self, images: &Tensor<f32>, train: bool) -> Tensor<f32> {
        let tape = Tape::with_pool(self.pool.clone());
        let mut net = Binder::selective(&tape, &self.weights.depth, if train { Mode::Train } else { Mode::Eval }, |_| false);
        self.model.depth.forward(&mut net, tape.constant(images.clone()))[0].value()
    }

    /// Optical flow of a batch, as far as it is needed: with a gradient in stages that train its network, else as observed.
    pub(super) fn flow_between<'t>(
        &self,
        net: &mut Binder<'t, f32>,
        batch: &Batch,
        ways: FlowWays,
        (stage, observed): (&StageConfig, Option<&BatchFlow>),
    ) -> Option<Flow<'t>> {
        let both_ways = match ways {
            FlowWays::None => return None,
            ways => ways == FlowWays::Both,
        };
        let tape = net.tape();
        if stage.train_flow {
            let images = &batch.plain;
            let targets = tape.constant(join_in(&self.pool, &[&images.target, &images.target]));
            let sources = tape.constant(join_in(&self.pool, &[&images.previous, &images.next]));
            let mut said =
                |first, second| *self.model.flow.forward(net, first, second, self.model.flow_iterations).last().expect("a flow");
            let backward = both_ways.then(|| said(sources, targets));
            let forward = said(targets, sources);
            return Some(Flow { forward, backward, trained: true });
        }
        let put = |flow: &BatchFlow| Flow {
            forward: tape.constant(flow.forward.clone()),
            backward: flow.backward.as_ref().filter(|_| both_ways).map(|back| tape.constant(back.clone())),
            trained: false,
        };
        let found = || ObservedFlow::default().of((&self.model, &self.weights.flow), batch, both_ways, &self.pool);
        Some(observed.map_or_else(|| put(&found()), put))
    }

    /// The sources of a batch without rotation, previous ones first.
    pub(super) fn rectified<'t>(
        &self,
        net: &RectifyNet,
        binder: &mut Binder<'t, f32>,
        batch: &Batch,
        step: u64,
    ) -> RectifiedSources<'t> {
        let (seen, plain) = (&batch.seen, &batch.plain);
        let target = join_in(&self.pool, &[&seen.target, &seen.target]);
        let [seen, plain] = [seen, plain].map(|images| join_in(&self.pool, &[&images.previous, &images.next]));
        let cameras = [&batch.intrinsics[..], &batch.intrinsics[..]].concat();
        let seed = rng::splitmix64(self.config.seed ^ ROTATIONS, step);
        rectified_sources(net, binder, [&target, &seen, &plain], &cameras, seed)
    }
}
