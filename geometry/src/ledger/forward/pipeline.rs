//! From estimates to losses over any [`Number`]: alignment and all four losses of a perturbed scene.

use dimode_autodiff::proof::Number;

use super::direction::{axial_signed, planar_circular, planar_weighted};
use super::ratio::{radial_loss, recovered, tangential_loss};
use super::{V2, V3, difference, fixed, projected, ray, rotated_back, scaled};
use crate::scenes::Perturbed;

/// What the losses are differentiated by, each 0 at the estimates themselves.
#[derive(Clone, Copy, Debug)]
pub struct Changes<N> {
    /// `eps` in `R exp([eps]_x)`, radians.
    pub eps: V3<N>,
    /// Added to `t'`, metres.
    pub in_target: V3<N>,
    /// Added to the logarithm of all target depths, to first order.
    pub log_target: N,
    /// The same at the chosen pixel alone.
    pub log_target_at: N,
    /// Added to the logarithm of all source depths, to first order.
    pub log_source: N,
    /// The same at the chosen pixel alone.
    pub log_source_at: N,
}

/// Number of changes.
pub const CHANGES: usize = 10;

impl<N: Number> Changes<N> {
    /// In the order `eps`, `in_target`, `log_target`, `log_target_at`, `log_source`, `log_source_at`.
    #[must_use]
    pub fn new([a, b, c, d, e, f, log_target, log_target_at, log_source, log_source_at]: [N; CHANGES]) -> Self {
        Self { eps: [a, b, c], in_target: [d, e, f], log_target, log_target_at, log_source, log_source_at }
    }

    /// Factors of the target and the source depth of a pixel.
    fn factors(&self, chosen: bool) -> [N; 2] {
        let factor = |all: N, one: N| N::one() + all + if chosen { one } else { N::zero() };
        [factor(self.log_target, self.log_target_at), factor(self.log_source, self.log_source_at)]
    }
}

/// Aligned flows, offsets, target depths and `t'` of a perturbed scene after changes.
#[derive(Clone, Debug)]
pub struct Aligned<N> {
    /// Planar flows, pixels.
    pub planar: Vec<V2<N>>,
    /// Axial flows, pixels.
    pub axial: Vec<V2<N>>,
    /// `p - p0`, pixels.
    pub offsets: Vec<V2<f64>>,
    /// Target depths.
    pub depths: Vec<N>,
    /// `t'`.
    pub in_target: V3<N>,
}

/// Aligns every pixel; `chosen` is the index of the pixel whose own depths change.
#[must_use]
pub fn align<N: Number>(estimate: &Perturbed, chosen: usize, changes: &Changes<N>) -> Aligned<N> {
    let camera = &estimate.scene.camera;
    let t: V3<N> = std::array::from_fn(|k| N::constant(estimate.in_target[k]) + changes.in_target[k]);
    let count = estimate.matches.len();
    let mut out = Aligned {
        planar: Vec::with_capacity(count),
        axial: Vec::with_capacity(count),
        offsets: Vec::with_capacity(count),
        depths: Vec::with_capacity(count),
        in_target: t,
    };
    for (i, (m, &z)) in estimate.matches.iter().zip(&estimate.target_depths).enumerate() {
        let [to_target, to_source] = changes.factors(i == chosen);
        let turned: V3<f64> = rotated_back(estimate.omega.into(), ray(camera, m.source.into()));
        let depth = N::constant(m.source_depth) * to_source;
        let point = scaled(rotated_back(changes.eps, fixed(turned)), depth);
        let flow = |removed: V3<N>| {
            let pixel = projected(camera, difference(point, removed));
            [pixel[0] - N::constant(m.target.x), pixel[1] - N::constant(m.target.y)]
        };
        out.planar.push(flow([N::zero(), N::zero(), t[2]]));
        out.axial.push(flow([t[0], t[1], N::zero()]));
        out.offsets.push([m.target.x - camera.u0, m.target.y - camera.v0]);
        out.depths.push(N::constant(z) * to_target);
    }
    out
}

/// Circular and weighted `L_pla`, sign-aware `L_axi`, printed `L_tan`, printed `L_rad`.
#[must_use]
pub fn losses<N: Number>(estimate: &Perturbed, chosen: usize, changes: [N; CHANGES]) -> [N; 5] {
    let x = align(estimate, chosen, &Changes::new(changes));
    [
        planar_circular(&x.planar),
        planar_weighted(&x.planar),
        axial_signed(&x.axial, &x.offsets, if x.in_target[2].value() > 0.0 { -1.0 } else { 1.0 }),
        tangential_loss(&estimate.scene.camera, &x.planar, &x.depths, x.in_target),
        radial_loss(&x.axial, &x.offsets, &x.depths, x.in_target[2]),
    ]
}

/// The translation that flows and target depths recover.
#[must_use]
pub fn recovered_translation<N: Number>(estimate: &Perturbed, chosen: usize, changes: [N; CHANGES]) -> V3<N> {
    let x = align(estimate, chosen, &Changes::new(changes));
    recovered(&estimate.scene.camera, [&x.planar, &x.axial], &x.offsets, &x.depths)
}
