//! The total loss `L = L_pho + smoothness + scale + lambda1 (L_axi + L_pla) + lambda2 (L_rad + L_tan) + lambda3 L_loc` of a batch,
//! term by term (paper, eq. `overall_loss`), and those of the methods that it is compared with.
//!
//! The terms are measured on a tape of their own whose leaves are what the networks said: disparities, rotations,
//! translations, and, where their networks are trained by these terms, optical flow and rectified images. That is where each
//! term's gradient with respect to depth, rotation and translation is read off.
//!
//! | file | terms | on when |
//! |---|---|---|
//! | `photometric.rs` | `l_pho` | always |
//! | `view_pairs.rs` | `l_geo` | `loss.geometry_consistency` |
//! | `smoothness.rs` | `smooth` | `loss.smoothness` |
//! | `scale_anchor.rs` | `scale` | `loss.scale_anchor` |
//! | `below_ground.rs` | `below_ground` | `loss.below_ground` |
//! | `local_structure.rs` | `l_loc_normals`, `l_loc_angles`, `l_loc_ranking` | `lambda3` of the stage, and a pseudo-depth |
//! | `flow_consistency.rs` | `flow_consistency` | `loss.flow_consistency` |
//! | `geometric.rs` | `l_pla`, `l_axi`, `l_tan`, `l_rad` | `lambda1`, `lambda2` of the stage |
//! | `cross_task.rs` | `cross_task` | `cross_task` of the stage |
//! | `contextual.rs` | `contextual`, `rigid`, `divergence` | those of the stage |
//!
//! The flow network's own loss, `l_flow`, is [`flow`]; that of a network that removes rotation, `l_rc` and `l_rt`, is [`rotation`].

mod below_ground;
mod contextual;
mod cross_task;
pub mod flow;
mod flow_consistency;
mod geometric;
mod local_structure;
mod needs;
mod outputs;
mod photometric;
mod report;
pub mod rotation;
mod scale_anchor;
mod scene;
mod smoothness;
mod term;
mod view_pairs;

use std::sync::Arc;

use dimode_autodiff::{Pool, Tape};

pub use needs::{FlowWays, Needs, SourceDepth};
pub use outputs::{Flow, OutputGradients, Outputs};
pub use report::{ImageReport, LossReport, TermGradients, TermReport};

use crate::batch::Batch;
use crate::config::{Config, LossConfig, StageConfig};
use crate::model::DepthRange;
use crate::non_finite::Failure;
use scene::Scene;
use term::TermKind;

/// The terms in the order in which they are summed.
const TERMS: [TermKind; 10] = [
    photometric::KIND,
    view_pairs::KIND,
    smoothness::KIND,
    scale_anchor::KIND,
    below_ground::KIND,
    local_structure::KIND,
    flow_consistency::KIND,
    geometric::KIND,
    cross_task::KIND,
    contextual::KIND,
];

/// What a stage asks of the networks.
pub fn needs(loss: &LossConfig, stage: &StageConfig) -> Needs {
    TERMS.iter().map(|kind| (kind.needs)(loss, stage)).fold(Needs::default(), Needs::and)
}

/// What a step brings along beside the networks' outputs.
#[derive(Clone, Copy)]
pub struct Given<'a> {
    /// The frames.
    pub batch: &'a Batch,
    /// The weights.
    pub stage: &'a StageConfig,
    /// Number of the step, from 0.
    pub step: u64,
    /// Whether each term's gradient is measured apart.
    pub probe: bool,
}

/// Measures every term of the stage, and the gradient of their weighted sum with respect to the outputs.
///
/// # Errors
/// When a term or its gradient is not finite.
///
/// # Panics
/// When an output is missing that the stage [`needs`].
pub fn measure(
    config: &Config,
    range: DepthRange,
    pool: &Arc<Pool<f32>>,
    outputs: &Outputs<'_>,
    given: &Given<'_>,
) -> Result<(LossReport, OutputGradients), Failure> {
    let Given { batch, stage, step, probe } = *given;
    let tape = Tape::with_pool(pool.clone());
    let leaves = outputs.on(&tape);
    let scene = Scene::new((&config.loss, stage), range, batch, &leaves, config.seed ^ (step << 20));
    let terms = TERMS.iter().flat_map(|kind| (kind.measure)(&scene)).collect();
    report::report(&tape, &leaves, terms, probe.then_some(range), batch.names.len())
}

#[cfg(test)]
mod tests;
