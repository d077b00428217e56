//! What the terms of a batch share.

use std::cell::OnceCell;

use dimode_autodiff::{Tape, Tensor, Var};
use dimode_geometry::Intrinsics;
use dimode_geometry::taped::matches::{Matching, best_matches_mask};
use dimode_geometry::taped::visibility::{consistency_score, reached, reached_softly};
use dimode_geometry::taped::{self, Pose, masks};

use super::outputs::{Flow, Outputs};
use super::view_pairs::{self, ViewPairs};
use crate::batch::{Batch, join_in};
use crate::config::{LossConfig, Occlusion, StageConfig};
use crate::losses::flow_data::REACHED;
use crate::losses::sc_depth_pair::PairMaps;
use crate::model::DepthRange;

/// The outputs of a batch as leaves, and what several terms make of them. Both sources are stacked along the samples, previous
/// ones first.
pub(super) struct Scene<'a, 'l> {
    pub loss: &'a LossConfig,
    pub stage: &'a StageConfig,
    pub batch: &'a Batch,
    pub range: DepthRange,
    pub leaves: &'a Outputs<'l>,
    /// Seed of this step's random choices.
    pub seed: u64,
    /// Cameras of the stacked samples.
    pub cameras: Vec<Intrinsics>,
    target_depth: OnceCell<Var<'l, f32>>,
    depth: OnceCell<Var<'l, f32>>,
    rigid: OnceCell<Var<'l, f32>>,
    source_depth: OnceCell<Var<'l, f32>>,
    pair_maps: OnceCell<Vec<PairMaps<'l, f32>>>,
    view_pairs: OnceCell<ViewPairs<'l>>,
}

impl<'a, 'l> Scene<'a, 'l> {
    pub fn new(
        (loss, stage): (&'a LossConfig, &'a StageConfig),
        range: DepthRange,
        batch: &'a Batch,
        leaves: &'a Outputs<'l>,
        seed: u64,
    ) -> Self {
        Scene {
            loss,
            stage,
            batch,
            range,
            leaves,
            seed,
            cameras: [&batch.intrinsics[..], &batch.intrinsics[..]].concat(),
            target_depth: OnceCell::new(),
            depth: OnceCell::new(),
            rigid: OnceCell::new(),
            source_depth: OnceCell::new(),
            pair_maps: OnceCell::new(),
            view_pairs: OnceCell::new(),
        }
    }

    pub fn tape(&self) -> &'l Tape<f32> {
        self.leaves.disparities[0].tape()
    }

    /// Depth of the target at full size, `[n, 1, h, w]`.
    pub fn target_depth(&self) -> Var<'l, f32> {
        *self.target_depth.get_or_init(|| self.range.depth(self.leaves.disparities[0]))
    }

    /// Depth of the target at full size, once for each source, `[2 n, 1, h, w]`.
    pub fn depth(&self) -> Var<'l, f32> {
        *self.depth.get_or_init(|| twice(self.target_depth()))
    }

    /// Snippets of the batch.
    pub fn samples(&self) -> usize {
        self.batch.names.len()
    }

    /// Motions `source_from_target`, 2 n of them.
    pub fn motion(&self) -> Pose<'l, f32> {
        self.leaves.motion
    }

    /// Flow and source depth by depth and motion, `[2 n, 3, h, w]`.
    pub fn rigid(&self) -> Var<'l, f32> {
        let Pose { rotation, translation } = self.motion();
        *self.rigid.get_or_init(|| taped::rigid_flow(self.depth(), rotation, translation, &self.cameras))
    }

    /// Flow from target to source by depth and motion, `[2 n, 2, h, w]`.
    pub fn rigid_flow(&self) -> Var<'l, f32> {
        self.rigid().slice(1, 0, 2)
    }

    /// Depth of the sources, `[2 n, 1, h, w]`.
    ///
    /// # Panics
    /// When no term needed it.
    pub fn source_depth(&self) -> Var<'l, f32> {
        let disparities = &self.leaves.source_disparities;
        *self.source_depth.get_or_init(|| self.range.depth(*disparities.first().expect("a term of this stage needs the sources")))
    }

    /// Optical flow.
    ///
    /// # Panics
    /// When no term needed it.
    pub fn flow(&self) -> Flow<'l> {
        self.leaves.flow.expect("a term of this stage needs the flow")
    }

    /// Where the optical flow is trusted, `[2 n, 1, h, w]`.
    pub fn trusted(&self) -> Tensor<f32> {
        let flow = self.flow();
        let forward = flow.forward.value();
        let seen = masks::in_view(&forward);
        let backward = || flow.backward.expect("the flow back is needed for this choice").value();
        match self.loss.occlusion {
            Occlusion::InView => seen,
            Occlusion::ForwardBackward => masks::all_of(&[&seen, &masks::not_occluded(&forward, &backward())]),
            Occlusion::BestMatches => {
                masks::all_of(&[&seen, &best_matches_mask(&consistency_score(&forward, &backward()), Matching::default())])
            }
            Occlusion::RangeMap => masks::all_of(&[&seen, &reached(&backward(), REACHED)]),
            Occlusion::SoftRangeMap => masks::all_of(&[&seen, &reached_softly(&backward())]),
        }
    }

    /// The maps of all view pairs as sc_depth_pl has them.
    pub fn pair_maps(&self) -> &[PairMaps<'l, f32>] {
        self.pair_maps.get_or_init(|| view_pairs::pair_maps(self))
    }

    /// The consistency of view pairs.
    pub fn view_pairs(&self) -> &ViewPairs<'l> {
        self.view_pairs.get_or_init(|| ViewPairs::new(self))
    }

    /// Both sources of the batch, without colour jitter, and without rotation where it was removed, `[2 n, 3, h, w]`.
    pub fn sources(&self) -> Var<'l, f32> {
        let images = &self.batch.plain;
        let joined = || self.tape().constant(join_in(self.tape().pool(), &[&images.previous, &images.next]));
        self.leaves.rectified.unwrap_or_else(joined)
    }
}

/// The same samples twice, one copy for each source.
pub(super) fn twice<'l>(x: Var<'l, f32>) -> Var<'l, f32> {
    Var::concat(&[x, x], 0)
}

/// Share of what a mask keeps.
pub(super) fn share(mask: &Tensor<f32>) -> f64 {
    mask.data().iter().map(|&m| f64::from(m)).sum::<f64>() / mask.shape().len() as f64
}
