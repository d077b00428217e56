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
    /// Says from the hidden state how each pixel combines 3x3 coarse neighbours; without it, bilinear with aligned corners.
    mask: Option<[ConvLayer; 2]>,
}

impl Upsampler {
    /// The upsampler of an update block stored under `path`.
    pub(super) fn new(path: &str, config: &FlowNetConfig) -> Self {
        let factor = config.factor();
        let mask = match config.variant {
            RaftVariant::Small => None,
            RaftVariant::Full(full) => Some([
                ConvLayer::new(format!("{path}.mask.0"), config.hidden, full.mask, 3),
                ConvLayer::new(format!("{path}.mask.2"), full.mask, 9 * factor * factor, 1),
            ]),
        };
        Self { factor, mask }
    }

    pub(super) fn declare(&self, blueprint: &mut Blueprint) {
        if let Some(head) = &self.mask {
            head.iter().for_each(|conv| conv.declare(blueprint));
        }
    }

    /// Flow (N, 2, h, w) in cells and hidden state (N, hidden, h, w) -> flow in pixels, (N, 2, factor h, factor w).
    pub(super) fn forward<'t, T: Scalar>(&self, binder: &Binder<'t, T>, flow: Var<'t, T>, hidden: Var<'t, T>) -> Var<'t, T> {
        let factor = self.factor;
        match &self.mask {
            None => {
                let (h, w) = (flow.shape().h() * factor, flow.shape().w() * factor);
                flow.resize_bilinear(h, w, true).last_use(|flow| flow.scale(factor as f64))
            }
            Some([first, second]) => {
                let mask = first.activated(binder, hidden, Activation::Relu);
                let mask = mask.last_use(|mask| second.forward(binder, mask)).last_use(|mask| mask.scale(MASK_SCALE));
                mask.last_use(|mask| flow.convex_upsample(mask, factor))
            }
        }
    }

    /// Counts the work of a flow that nobody asked for: the definition enlarges the flow of every iteration.
    pub(super) fn skip<T: Scalar>(&self, binder: &Binder<'_, T>, flow: Shape) {
        if let Some(head) = &self.mask {
            let cells = flow.n() * flow.plane();
            binder.count_macs(head.iter().map(|conv| cells * conv.macs_per_position()).sum());
        }
    }
}
