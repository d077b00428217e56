//! The decoder of Lite-Mono.

use dimode_autodiff::{Scalar, Var};

use super::LiteMonoConfig;
use crate::layers::ReflectConv;
use crate::{Binder, Blueprint};

/// Deviation of the weights at the start.
const START: f64 = 0.02;

/// At each level a [`ReflectConv`], bilinear doubling, concatenation with the encoder's feature of that size, another
/// [`ReflectConv`], and a head whose map is doubled before the sigmoid.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Decoder {
    /// Before and after the doubling, for level 0 to 2.
    units: [[ReflectConv; 2]; 3],
    /// Scale and head, in the configured order.
    heads: Vec<(usize, ReflectConv)>,
}

impl Decoder {
    /// The decoder stored in the checkpoint file `file`.
    pub(super) fn new(file: &str, config: &LiteMonoConfig) -> Self {
        let dims = config.dims;
        let width = |level: usize| dims[level] / 2;
        let unit = |level: usize| {
            let name = |n: usize| format!("{file}:decoder.{}.conv.conv", 2 * (2 - level) + n);
            let below = if level == 2 { dims[2] } else { width(level + 1) };
            let skip = if level > 0 { dims[level - 1] } else { 0 };
            [
                ReflectConv::new(name(0), below, width(level)).normal(START),
                ReflectConv::new(name(1), width(level) + skip, width(level)).normal(START),
            ]
        };
        let head = |(position, &scale): (usize, &usize)| {
            let path = format!("{file}:decoder.{}.conv", 6 + position);
            (scale, ReflectConv::head(path, width(scale), 1).normal(START))
        };
        Self { units: std::array::from_fn(unit), heads: config.scales.iter().enumerate().map(head).collect() }
    }

    pub(super) fn declare(&self, blueprint: &mut Blueprint) {
        for unit in self.units.iter().rev().flatten() {
            unit.declare(blueprint);
        }
        self.heads.iter().for_each(|(_, head)| head.declare(blueprint));
    }

    /// Number of disparities.
    pub(super) fn scales(&self) -> usize {
        self.heads.len()
    }

    /// Three features, fine to coarse -> one disparity in (0, 1) per scale, (N, 1, H / 2^s, W / 2^s), finest first.
    pub(super) fn forward<'t, T: Scalar>(&self, binder: &Binder<'t, T>, features: &[Var<'t, T>; 3]) -> Vec<Var<'t, T>> {
        let mut disparities = Vec::with_capacity(self.heads.len());
        let mut x = features[2];
        for (level, [before, after]) in self.units.iter().enumerate().rev() {
            let y = before.forward(binder, x);
            if level < 2 {
                x.release();
            }
            x = y.last_use(doubled);
            if level > 0 {
                x = x.last_use(|x| Var::concat(&[x, features[level - 1]], 1));
            }
            x = x.last_use(|x| after.forward(binder, x));
            if let Some((_, head)) = self.heads.iter().find(|(scale, _)| *scale == level) {
                disparities.push(head.linear(binder, x).last_use(doubled).last_use(Var::sigmoid));
            }
        }
        x.release();
        disparities.reverse();
        disparities
    }
}

/// Twice as high and wide, bilinear with half-pixel centres.
fn doubled<T: Scalar>(x: Var<'_, T>) -> Var<'_, T> {
    let shape = x.shape();
    x.resize_bilinear(2 * shape.h(), 2 * shape.w(), false)
}
