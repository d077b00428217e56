//! Features of the current flow and of what the correlation says about it.

use dimode_autodiff::{Activation, Scalar, Var};

use super::{FlowNetConfig, RaftVariant};
use crate::layers::ConvLayer;
use crate::{Binder, Blueprint};

/// Two branches, joined by a 3x3 convolution.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct MotionEncoder {
    correlation: Vec<ConvLayer>,
    flow: [ConvLayer; 2],
    joint: ConvLayer,
}

impl MotionEncoder {
    pub(super) fn new(path: &str, config: &FlowNetConfig) -> Self {
        let conv = |name: &str, inputs, outputs, kernel| ConvLayer::new(format!("{path}.{name}"), inputs, outputs, kernel);
        let [wide, narrow] = config.flow;
        let lookup = config.lookup_channels();
        Self {
            correlation: match config.variant {
                RaftVariant::Small => vec![conv("convc1", lookup, config.correlation, 1)],
                RaftVariant::Full(full) => {
                    vec![conv("convc1", lookup, full.lookup, 1), conv("convc2", full.lookup, config.correlation, 3)]
                }
            },
            flow: [conv("convf1", 2, wide, 7), conv("convf2", wide, narrow, 3)],
            joint: conv("conv", config.correlation + narrow, config.motion, 3),
        }
    }

    pub(super) fn declare(&self, blueprint: &mut Blueprint) {
        self.correlation.iter().for_each(|conv| conv.declare(blueprint));
        self.flow.iter().for_each(|conv| conv.declare(blueprint));
        self.joint.declare(blueprint);
    }

    /// Look-up (N, L, h, w) and flow (N, 2, h, w) -> (N, motion + 2, h, w), the flow itself last.
    pub(super) fn forward<'t, T: Scalar>(&self, binder: &Binder<'t, T>, lookup: Var<'t, T>, flow: Var<'t, T>) -> Var<'t, T> {
        let mut correlation = lookup;
        for (i, conv) in self.correlation.iter().enumerate() {
            let next = conv.activated(binder, correlation, Activation::Relu);
            if i > 0 {
                correlation.release();
            }
            correlation = next;
        }
        let [wide, narrow] = &self.flow;
        let branch = wide.activated(binder, flow, Activation::Relu);
        let branch = branch.last_use(|branch| narrow.activated(binder, branch, Activation::Relu));
        let joint = correlation.last_use(|correlation| branch.last_use(|branch| Var::concat(&[correlation, branch], 1)));
        let motion = joint.last_use(|joint| self.joint.activated(binder, joint, Activation::Relu));
        motion.last_use(|motion| Var::concat(&[motion, flow], 1))
    }
}
