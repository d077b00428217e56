//! Positional features injected into semantic ones, from fine to coarse (HPEI of SCIPaD).

use dimode_autodiff::{Activation, Scalar, Var};

use crate::layers::ConvLayer;
use crate::{Binder, Blueprint, Init};

/// Weights of the mixture, a projection for each of four levels and a convolution to the next one for the first three. The fourth
/// weight and the fourth projection exist in checkpoints and are not used.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Injector {
    alpha: String,
    projections: [ConvLayer; 4],
    convs: [ConvLayer; 3],
}

impl Injector {
    /// The injector stored under `path`: semantic features of the given widths, positional ones of width `embedding`.
    pub(super) fn new(path: &str, widths: [usize; 4], embedding: usize) -> Self {
        let projection = |i: usize| ConvLayer::new(format!("{path}.chn_reduction.{i}"), embedding, widths[i], 1);
        let conv = |i: usize| ConvLayer::new(format!("{path}.conv.{i}"), widths[i], widths[i + 1], 3);
        Self { alpha: format!("{path}.alpha"), projections: std::array::from_fn(projection), convs: std::array::from_fn(conv) }
    }

    pub(super) fn declare(&self, blueprint: &mut Blueprint) {
        blueprint.parameter(self.alpha.clone(), &[4], Init::Constant(0.0));
        self.projections.iter().for_each(|conv| conv.declare(blueprint));
        self.convs.iter().for_each(|conv| conv.declare(blueprint));
    }

    /// Semantic features of four levels and positional ones of the first three -> (N, widths\[3\], H / 32, W / 32).
    ///
    /// At each level `y = alpha projection(position) + (1 - alpha) semantic + fused`, and the next `fused` is `ReLU(conv(y))` at
    /// half the size; the last one is added to the fourth semantic feature. Fresh weights have `alpha = 0`.
    pub(super) fn forward<'t, T: Scalar>(
        &self,
        binder: &Binder<'t, T>,
        semantic: [Var<'t, T>; 4],
        position: [Var<'t, T>; 3],
    ) -> Var<'t, T> {
        let alpha = binder.param(&self.alpha);
        let [fine @ .., coarsest] = semantic;
        let mut fused: Option<Var<'t, T>> = None;
        for (i, (semantic, position)) in fine.into_iter().zip(position).enumerate() {
            let projected = self.projections[i].forward(binder, position);
            let difference = projected.last_use(|projected| projected.sub(semantic));
            let alpha = alpha.slice(1, i, 1).broadcast_to(semantic.shape());
            let change = difference.last_use(|difference| alpha.last_use(|alpha| alpha.mul(difference)));
            let mixed = change.last_use(|change| semantic.add(change));
            let sum = match fused {
                None => mixed,
                Some(fused) => mixed.last_use(|mixed| fused.last_use(|fused| mixed.add(fused))),
            };
            let next = sum.last_use(|sum| self.convs[i].activated(binder, sum, Activation::Relu));
            // Bilinear to half the size without a filter: with half-pixel centres the mean of two by two.
            fused = Some(next.last_use(|next| next.avg_pool2d(2, 2, 0)));
        }
        match fused {
            None => coarsest,
            Some(fused) => fused.last_use(|fused| coarsest.add(fused)),
        }
    }
}
