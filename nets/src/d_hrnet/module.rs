//! A module of HRNet: every branch on its own, then each from all.

use dimode_autodiff::{Activation, Scalar, Var};

use super::conv_norm::ConvNorm;
use crate::layers::BasicBlock;
use crate::{Binder, Blueprint};

/// Residual blocks on parallel branches, each half the size of the one before, and their fusion.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Module {
    branches: Vec<Vec<BasicBlock>>,
    fusions: Vec<Fusion>,
}

/// What the branches become for one of them: `ReLU(sum of T_j(x_j))`.
#[derive(Clone, Debug, PartialEq)]
struct Fusion {
    /// Three-by-three convolutions with stride 2 from each finer branch, the finest first.
    finer: Vec<Vec<ConvNorm>>,
    /// One-by-one convolutions from each coarser branch.
    coarser: Vec<ConvNorm>,
}

impl Module {
    /// The module stored under `path`, for branches of the given widths, fine to coarse.
    pub(super) fn new(path: &str, widths: &[usize], blocks: usize) -> Self {
        let block = |b: usize, j: usize| BasicBlock::new(&format!("{path}.branches.{b}.{j}"), widths[b], widths[b], 1);
        Self {
            branches: (0..widths.len()).map(|b| (0..blocks).map(|j| block(b, j)).collect()).collect(),
            fusions: (0..widths.len()).map(|i| Fusion::new(&format!("{path}.fuse_layers.{i}"), i, widths)).collect(),
        }
    }

    pub(super) fn declare(&self, blueprint: &mut Blueprint) {
        self.branches.iter().flatten().for_each(|block| block.declare(blueprint));
        for fusion in &self.fusions {
            fusion.finer.iter().flatten().chain(&fusion.coarser).for_each(|conv| conv.declare(blueprint));
        }
    }

    /// One map for each branch -> the same; gives up the values of the maps.
    pub(super) fn forward<'t, T: Scalar>(&self, binder: &mut Binder<'t, T>, maps: Vec<Var<'t, T>>) -> Vec<Var<'t, T>> {
        let mut run = |(blocks, x): (&Vec<BasicBlock>, Var<'t, T>)| {
            blocks.iter().fold(x, |x, block| x.last_use(|x| block.forward(binder, x)))
        };
        let maps: Vec<_> = self.branches.iter().zip(maps).map(&mut run).collect();
        let fused = self.fusions.iter().enumerate().map(|(i, fusion)| fusion.forward(binder, i, &maps)).collect();
        maps.iter().for_each(|map| map.release());
        fused
    }
}

impl Fusion {
    fn new(path: &str, i: usize, widths: &[usize]) -> Self {
        let steps = |j: usize| {
            let step = |s: usize| {
                let outputs = if s + 1 == i - j { widths[i] } else { widths[j] };
                ConvNorm::pair(&format!("{path}.{j}.{s}"), [widths[j], outputs], 3, 2)
            };
            (0..i - j).map(step).collect()
        };
        let coarser = |j: usize| ConvNorm::pair(&format!("{path}.{j}"), [widths[j], widths[i]], 1, 1);
        Self { finer: (0..i).map(steps).collect(), coarser: (i + 1..widths.len()).map(coarser).collect() }
    }

    /// The maps of all branches -> the new map of branch `i`.
    ///
    /// The coarser branches come first, so that each normalisation of a finer one adds to the sum, and the last one rectifies it.
    fn forward<'t, T: Scalar>(&self, binder: &mut Binder<'t, T>, i: usize, maps: &[Var<'t, T>]) -> Var<'t, T> {
        let own = maps[i];
        let (height, width) = (own.shape().h(), own.shape().w());
        // The map of the branch itself stays for the others; sums made of it go as they are used.
        let mut made: Option<Var<'t, T>> = None;
        let mut replace = |next: Var<'t, T>| {
            if let Some(before) = made.replace(next) {
                before.release();
            }
            next
        };
        let mut sum = own;
        for (conv, &map) in self.coarser.iter().zip(&maps[i + 1..]) {
            let term = conv.forward(binder, map, Activation::Identity);
            let term = term.last_use(|term| term.resize_bilinear(height, width, true));
            sum = replace(term.last_use(|term| sum.add(term)));
        }
        for (j, (steps, &map)) in self.finer.iter().zip(maps).enumerate() {
            let (last, before) = steps.split_last().expect("a finer branch takes at least one step");
            let mut x = map;
            for (s, step) in before.iter().enumerate() {
                let y = step.forward(binder, x, Activation::Relu);
                if s > 0 {
                    x.release();
                }
                x = y;
            }
            let activation = if j + 1 == i { Activation::Relu } else { Activation::Identity };
            sum = replace(last.joined(binder, x, Some(sum), activation));
            if !before.is_empty() {
                x.release();
            }
        }
        if self.finer.is_empty() { replace(sum.relu()) } else { sum }
    }
}
