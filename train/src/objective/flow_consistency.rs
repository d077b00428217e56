//! `flow_consistency`: plain difference of rigid and optical flow on the static scene, pixels.

use dimode_geometry::taped::masks;

use super::needs::{FlowWays, Needs};
use super::scene::{Scene, share};
use super::term::{Term, TermKind};
use crate::config::{LossConfig, StageConfig};
use crate::losses::flow_consistency::flow_consistency;

pub(super) const KIND: TermKind = TermKind { needs, measure };

fn needs(loss: &LossConfig, _: &StageConfig) -> Needs {
    let flow = if loss.flow_consistency > 0.0 { FlowWays::to_trust(loss.occlusion) } else { FlowWays::None };
    Needs { flow, ..Needs::default() }
}

fn measure<'l>(scene: &Scene<'_, 'l>) -> Vec<Term<'l>> {
    let weight = scene.loss.flow_consistency;
    if weight == 0.0 {
        return Vec::new();
    }
    let (rigid, flow) = (scene.rigid_flow(), scene.flow().forward.value());
    let mask = masks::static_pixels(&rigid.value(), &flow, Some(&scene.trusted()));
    vec![Term::new("flow_consistency", weight, flow_consistency(rigid, &flow, &mask), share(&mask))]
}
