//! Depth decoder with skip connections and one disparity head per scale.

use dimode_autodiff::{Scalar, Var};

use crate::layers::ReflectConv;
use crate::{Binder, Blueprint};

/// Upsampling decoder: at each level a [`ReflectConv`], nearest-neighbour doubling, concatenation
/// with the encoder's feature of that size, another [`ReflectConv`], and a sigmoid head.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthDecoder {
    /// Before and after the doubling, for level 0 (full size) to 4.
    units: Vec<[ReflectConv; 2]>,
    /// Scale and head, in the configured order.
    heads: Vec<(usize, ReflectConv)>,
}

impl DepthDecoder {
    /// The decoder stored in the checkpoint file `file`.
    ///
    /// * `encoder`: channels of the five features, fine to coarse.
    /// * `widths`: channels of the decoder at levels 0 (full size) to 4.
    /// * `scales`: levels that have a head, each below 4 by convention; the order fixes the names.
    pub fn new(file: &str, encoder: [usize; 5], widths: [usize; 5], scales: &[usize]) -> Self {
        let unit = |level: usize| {
            let number = 2 * (4 - level);
            let name = |n: usize| format!("{file}:decoder.{n}.conv.conv");
            let below = if level == 4 { encoder[4] } else { widths[level + 1] };
            let skip = if level > 0 { encoder[level - 1] } else { 0 };
            let width = widths[level];
            [ReflectConv::new(name(number), below, width), ReflectConv::new(name(number + 1), width + skip, width)]
        };
        let head = |(position, &scale): (usize, &usize)| {
            let path = format!("{file}:decoder.{}.conv", 10 + position);
            (scale, ReflectConv::head(path, widths[scale], 1))
        };
        Self { units: (0..5).map(unit).collect(), heads: scales.iter().enumerate().map(head).collect() }
    }

    /// Adds the tensors of the decoder to the list.
    pub fn declare(&self, blueprint: &mut Blueprint) {
        for unit in self.units.iter().rev().flatten() {
            unit.declare(blueprint);
        }
        self.heads.iter().for_each(|(_, h)| h.declare(blueprint));
    }

    /// Number of disparities.
    pub fn scales(&self) -> usize {
        self.heads.len()
    }

    /// Five features, fine to coarse -> one disparity in (0, 1) per scale, (N, 1, H / 2^s, W / 2^s),
    /// finest first.
    pub fn forward<'t, T: Scalar>(&self, binder: &Binder<'t, T>, features: &[Var<'t, T>; 5]) -> Vec<Var<'t, T>> {
        let mut disparities = Vec::with_capacity(self.heads.len());
        let mut x = features[4];
        for level in (0..5).rev() {
            let [before, after] = &self.units[level];
            x = before.forward(binder, x).last_use(|x| x.upsample_nearest(2));
            if level > 0 {
                x = x.last_use(|x| Var::concat(&[x, features[level - 1]], 1));
            }
            x = x.last_use(|x| after.forward(binder, x));
            let head = self.heads.iter().find(|(scale, _)| *scale == level);
            if let Some((_, head)) = head {
                disparities.push(head.linear(binder, x).last_use(Var::sigmoid));
            }
        }
        disparities.reverse();
        disparities
    }
}
