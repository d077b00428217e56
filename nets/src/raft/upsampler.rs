//! From the flow of the coarse grid to the flow of the image.

use dimode_autodiff::{Activation, Scalar, Shape, Var};

use super::{FlowNetConfig, RaftVariant};
use crate::layers::ConvLayer;
use crate::{Binder, Blueprint};

/// Factor on the logits of the mask head, which keeps their gradient small.
const MASK_SCALE: f64 = 0.25;

/// How the flow is enlarged. Its values grow with the size.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Upsampler {
    factor: usize,
    weights: Weights,
}

/// Where the weights of the interpolation come from.
#[derive(Clone, Debug, PartialEq)]
enum Weights {
    /// Bilinear with aligned corners.
    Bilinear,
    /// A convex combination of 3x3 coarse neighbours, by a head on the hidden state.
    Learned([ConvLayer; 2]),
}

impl Upsampler {
    /// The upsampler of an update block stored under `path`.
    pub(super) fn new(path: &str, config: &FlowNetConfig) -> Self {
        let factor = config.factor();
        let weights = match config.variant {
            RaftVariant::Small => Weights::Bilinear,
            RaftVariant::Full(full) => Weights::Learned([
                ConvLayer::new(format!("{path}.mask.0"), config.hidden, full.mask, 3),
                ConvLayer::new(format!("{path}.mask.2"), full.mask, 9 * factor * factor, 1),
            ]),
        };
        Self { factor, weights }
    }

    pub(super) fn declare(&self, blueprint: &mut Blueprint) {
        if let Weights::Learned(head) = &self.weights {
            head.iter().for_each(|conv| conv.declare(blueprint));
        }
    }

    /// Flow (N, 2, h, w) in cells and hidden state (N, hidden, h, w) -> flow in pixels, (N, 2, factor h, factor w).
    pub(super) fn forward<'t, T: Scalar>(&self, binder: &Binder<'t, T>, flow: Var<'t, T>, hidden: Var<'t, T>) -> Var<'t, T> {
        let factor = self.factor;
        match &self.weights {
            Weights::Bilinear => {
                let (h, w) = (flow.shape().h() * factor, flow.shape().w() * factor);
                flow.resize_bilinear(h, w, true).last_use(|flow| flow.scale(factor as f64))
            }
            Weights::Learned([first, second]) => {
                let mask = first.activated(binder, hidden, Activation::Relu);
                let mask = mask.last_use(|mask| second.forward(binder, mask)).last_use(|mask| mask.scale(MASK_SCALE));
                mask.last_use(|mask| flow.convex_upsample(mask, factor))
            }
        }
    }

    /// Counts the work of a flow that nobody asked for: the definition enlarges the flow of every iteration.
    pub(super) fn skip<T: Scalar>(&self, binder: &Binder<'_, T>, flow: Shape) {
        if let Weights::Learned(head) = &self.weights {
            let cells = flow.n() * flow.plane();
            binder.count_macs(head.iter().map(|conv| cells * conv.macs_per_position()).sum());
        }
    }
}
