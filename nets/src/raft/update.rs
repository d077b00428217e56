//! One refinement step: motion features, recurrent unit, flow head.

use dimode_autodiff::{Activation, Scalar, Var};

use super::FlowNetConfig;
use super::gru::{Gru, GruState};
use super::motion_encoder::MotionEncoder;
use crate::layers::ConvLayer;
use crate::{Binder, Blueprint};

/// Names and sizes of the refinement step.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct UpdateBlock {
    encoder: MotionEncoder,
    gru: Gru,
    head: [ConvLayer; 2],
}

impl UpdateBlock {
    pub(super) fn new(path: &str, config: &FlowNetConfig) -> Self {
        let head = |n: usize, inputs, outputs| ConvLayer::new(format!("{path}.flow_head.conv{n}"), inputs, outputs, 3);
        Self {
            encoder: MotionEncoder::new(&format!("{path}.encoder"), config),
            gru: Gru::new(&format!("{path}.gru"), config),
            head: [head(1, config.hidden, config.head), head(2, config.head, 2)],
        }
    }

    pub(super) fn declare(&self, blueprint: &mut Blueprint) {
        self.encoder.declare(blueprint);
        self.gru.declare(blueprint);
        self.head.iter().for_each(|conv| conv.declare(blueprint));
    }

    /// The part that no iteration changes.
    pub(super) fn prepare<'t, T: Scalar>(&self, binder: &Binder<'t, T>, context: Var<'t, T>) -> GruState<'t, T> {
        self.gru.prepare(binder, context)
    }

    /// Hidden state, look-up and detached flow -> new hidden state and flow increment, in cells.
    pub(super) fn step<'t, T: Scalar>(
        &self,
        binder: &Binder<'t, T>,
        gru: &GruState<'t, T>,
        hidden: Var<'t, T>,
        lookup: Var<'t, T>,
        flow: Var<'t, T>,
    ) -> (Var<'t, T>, Var<'t, T>) {
        let motion = self.encoder.forward(binder, lookup, flow);
        let hidden = motion.last_use(|motion| gru.step(binder, hidden, motion));
        let [first, second] = &self.head;
        let delta = first.activated(binder, hidden, Activation::Relu);
        (hidden, delta.last_use(|delta| second.forward(binder, delta)))
    }
}
