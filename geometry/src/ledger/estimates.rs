//! A perturbed scene through the plain forms and through the tape: values of all losses, and their derivatives by the estimates.

use dimode_autodiff::{Shape, Tape, Tensor, Var};
use nalgebra::Vector3;

use crate::camera::Intrinsics;
use crate::loss_forms;
use crate::losses::{AlignedPair, LossOptions, LossTerm, PairInputs};
use crate::scenes::{Perturbed, STEP};
use crate::taped::{masks, so3_exp};

/// Losses of a perturbed scene, plain forms, consistent convention.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlainLosses {
    /// `L_pla`: circular, as printed, weighted.
    pub planar: [f64; 3],
    /// `L_axi`: sign-aware, as printed.
    pub axial: [f64; 2],
    /// `L_tan` as printed.
    pub tangential: f64,
    /// `L_rad` as printed.
    pub radial: f64,
}

impl PlainLosses {
    /// Evaluates all.
    #[must_use]
    pub fn new(estimate: &Perturbed) -> Self {
        let (planar, axial, d) = (estimate.planar_flows(), estimate.axial_flows(), estimate.scene.offsets());
        let (camera, depths, a) = (&estimate.scene.camera, &estimate.target_depths, &estimate.in_target);
        Self {
            planar: [loss_forms::planar::circular, loss_forms::planar::printed, loss_forms::planar::weighted]
                .map(|form| form(&planar)),
            axial: [loss_forms::axial::pose_sign(&axial, &d, a.z), loss_forms::axial::printed(&axial, &d)],
            tangential: loss_forms::tangential::printed(camera, &planar, depths, a),
            radial: loss_forms::radial::printed(&axial, &d, depths, a),
        }
    }

    /// In the order of the fields.
    #[must_use]
    pub fn to_array(&self) -> [f64; 7] {
        let ([circular, printed, weighted], [signed, literal]) = (self.planar, self.axial);
        [circular, printed, weighted, signed, literal, self.tangential, self.radial]
    }

    /// Those that [`super::forward::pipeline::losses`] gives, in its order.
    #[must_use]
    pub fn differentiated(&self) -> [f64; 5] {
        [self.planar[0], self.planar[2], self.axial[0], self.tangential, self.radial]
    }
}

/// How far the pixels of a perturbed scene stay away from the kinks and poles of the losses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clearance {
    /// Smallest planar flow component or radial component of an axial flow, pixels: what the ratios divide by.
    pub divisor: f64,
    /// Smallest sine of the angle between an axial flow and its radius: at 0 `L_axi` has its kink, and `arccos` no derivative.
    pub radial: f64,
    /// Smallest sine of the angle between a planar flow and the horizontal, where the `arccos` of `L_pla` has none.
    pub horizontal: f64,
}

impl Clearance {
    /// The smallest over all pixels.
    #[must_use]
    pub fn new(estimate: &Perturbed) -> Self {
        let mut least = Self { divisor: f64::INFINITY, radial: f64::INFINITY, horizontal: f64::INFINITY };
        let flows = estimate.planar_flows().into_iter().zip(estimate.axial_flows());
        for ((planar, axial), d) in flows.zip(estimate.scene.offsets()) {
            let along = axial.dot(&d).abs() / d.norm();
            least.divisor = least.divisor.min(planar.x.abs()).min(planar.y.abs()).min(along);
            least.radial = least.radial.min(axial.perp(&d).abs() / (axial.norm() * d.norm()));
            least.horizontal = least.horizontal.min(planar.y.abs() / planar.norm());
        }
        least
    }

    /// How much more rounding a ratio carries than numbers of usual size: `max(1, 0.01 px / divisor)`.
    ///
    /// Flows of whole images are exact to some 1e-13 px. Divided by 0.01 px that leaves ten digits, by less it leaves fewer.
    #[must_use]
    pub fn rounding(&self) -> f64 {
        (0.01 / self.divisor).max(1.0)
    }
}

/// A loss on the tape.
pub type Form = for<'t> fn(&AlignedPair<'t, f64>, &LossOptions) -> LossTerm<'t, f64>;

/// One loss of a perturbed scene on the tape, with its derivatives.
#[derive(Clone, Debug, PartialEq)]
pub struct TapedLoss {
    /// Its value; losses in pixels count pixels of the grid's image.
    pub value: f64,
    /// By `eps` in `R exp([eps]_x)`, 1 / rad.
    pub eps: Vector3<f64>,
    /// By `t'`, 1 / m.
    pub in_target: Vector3<f64>,
    /// By the logarithm of every target depth.
    pub log_target: Vec<f64>,
    /// By the logarithm of every source depth.
    pub log_source: Vec<f64>,
}

impl TapedLoss {
    /// In the order of [`super::forward::pipeline::Changes`].
    #[must_use]
    pub fn changes(&self, chosen: usize) -> [f64; super::forward::pipeline::CHANGES] {
        let ([a, b, c], [d, e, f]): ([f64; 3], [f64; 3]) = (self.eps.into(), self.in_target.into());
        let depths = |x: &[f64]| [x.iter().sum(), x[chosen]];
        let ([target, target_at], [source, source_at]) = (depths(&self.log_target), depths(&self.log_source));
        [a, b, c, d, e, f, target, target_at, source, source_at]
    }
}

/// Options whose thresholds in pixels are those of the grid's image, [`STEP`] times smaller than in the scene's.
#[must_use]
pub fn on_the_grid(options: &LossOptions) -> LossOptions {
    let s = 1.0 / STEP as f64;
    LossOptions {
        tau_flow: options.tau_flow * s,
        tau_ratio: options.tau_ratio * s,
        q_min: options.q_min * s,
        min_tangential_flow: options.min_tangential_flow * s,
        smooth_pixels: options.smooth_pixels * s,
        noise_pixels: options.noise_pixels * s,
        ..*options
    }
}

/// The estimates on a tape: `eps`, `t'`, target depths, source depths.
struct Leaves<'t>([Var<'t, f64>; 4]);

impl<'t> Leaves<'t> {
    fn new(tape: &'t Tape<f64>, estimate: &Perturbed) -> Self {
        let map = map_shape(estimate);
        let source = estimate.matches.iter().map(|m| m.source_depth).collect();
        let vector = |v: &Vector3<f64>| Tensor::from_vec(Shape::new(1, 3, 1, 1), v.as_slice().to_vec());
        Self([
            tape.leaf(vector(&Vector3::zeros())),
            tape.leaf(vector(&estimate.in_target)),
            tape.leaf(Tensor::from_vec(map, estimate.target_depths.clone())),
            tape.leaf(Tensor::from_vec(map, source)),
        ])
    }

    fn pair(&self, estimate: &Perturbed, options: &LossOptions) -> AlignedPair<'t, f64> {
        let [eps, in_target, target_depth, source_depth] = self.0;
        let tape = eps.tape();
        let map = map_shape(estimate);
        let omega = Tensor::from_vec(Shape::new(1, 3, 1, 1), estimate.omega.as_slice().to_vec());
        let rotation = so3_exp(tape.constant(omega)).matmul(so3_exp(eps));
        let column = |v: Var<'t, f64>| v.reshape(Shape::new(1, 1, 3, 1));
        let translation = rotation.matmul(column(in_target)).reshape(Shape::new(1, 3, 1, 1));
        let flow = |c: usize, i: usize| (estimate.matches[i].source - estimate.matches[i].target)[c] / STEP as f64;
        let flow = Tensor::from_fn(Shape::new(1, 2, map.h(), map.w()), |_, c, v, u| flow(c, v * map.w() + u));
        let inputs = PairInputs {
            target_depth,
            source_depth,
            flow: tape.constant(flow),
            rotation,
            translation,
            intrinsics: &[estimate.scene.grid_camera()],
            mask: &masks::everywhere(map),
        };
        AlignedPair::from_sampled(&inputs, options)
    }
}

fn map_shape(estimate: &Perturbed) -> Shape {
    let [w, h] = estimate.scene.grid;
    Shape::new(1, 1, h, w)
}

/// Evaluates and differentiates one number of the aligned pair; pixels of the grid are the pixels of a small image.
#[must_use]
pub fn taped(
    estimate: &Perturbed,
    options: &LossOptions,
    form: impl for<'t> Fn(&AlignedPair<'t, f64>, &LossOptions) -> Var<'t, f64>,
) -> TapedLoss {
    let tape = Tape::new();
    let leaves = Leaves::new(&tape, estimate);
    let value = form(&leaves.pair(estimate, options), options);
    let gradients = tape.backward(value);
    let [eps, in_target, target, source] = leaves.0;
    let vector = |v: Var<'_, f64>| Vector3::from_column_slice(gradients.wrt(v).data());
    let by_logarithm = |v: Var<'_, f64>| gradients.wrt(v).data().iter().zip(v.value().data()).map(|(g, z)| g * z).collect();
    TapedLoss {
        value: value.value().item(),
        eps: vector(eps),
        in_target: vector(in_target),
        log_target: by_logarithm(target),
        log_source: by_logarithm(source),
    }
}

/// As [`taped`], for one of the losses.
#[must_use]
pub fn taped_loss(estimate: &Perturbed, options: &LossOptions, form: Form) -> TapedLoss {
    taped(estimate, options, |pair, options| form(pair, options).mean)
}

/// Component `k` of the translation that a pair recovers, the mean of `z / rho_k` over all its pixels, on the tape.
#[must_use]
pub fn recovered<'t>(pair: &AlignedPair<'t, f64>, camera: &Intrinsics, k: usize) -> Var<'t, f64> {
    let depth = pair.target_depth;
    let along_axis = |focal: f64| depth.mul(pair.planar_flow.slice(1, k, 1)).scale(1.0 / focal).mean();
    match k {
        0 => along_axis(camera.fu),
        1 => along_axis(camera.fv),
        _ => {
            let offset =
                |of: &dyn Fn(usize, usize) -> f64| depth.tape().constant(Tensor::from_fn(depth.shape(), |_, _, v, u| of(v, u)));
            let (d_u, d_v) = (offset(&|_, u| u as f64 - camera.u0), offset(&|v, _| v as f64 - camera.v0));
            let along = pair.axial_flow.slice(1, 0, 1).mul(d_u).add(pair.axial_flow.slice(1, 1, 1).mul(d_v));
            let whole = along.add(d_u.square()).add(d_v.square());
            depth.mul(along).div(whole).neg().mean()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::losses;
    use crate::scenes;

    #[test]
    fn pixel_losses_of_the_grid_are_those_of_the_scene_in_grid_pixels() {
        let estimate = scenes::perturbed_generic();
        let options = LossOptions { noise_pixels: 0.0, noise_share: 0.0, ..LossOptions::default() };
        let found = taped_loss(&estimate, &on_the_grid(&options), losses::tangential).value * STEP as f64;
        let (flows, depths) = (estimate.planar_flows(), &estimate.target_depths);
        let plain = loss_forms::tangential::flow_pixels(&estimate.scene.camera, &flows, depths, &estimate.in_target);
        assert!((found - plain).abs() < 1e-12 * plain, "{found} {plain}");
    }

    #[test]
    fn columns_of_changes_are_in_order() {
        let loss = TapedLoss {
            value: 0.0,
            eps: Vector3::new(1.0, 2.0, 3.0),
            in_target: Vector3::new(4.0, 5.0, 6.0),
            log_target: vec![3.0, 4.0],
            log_source: vec![5.0, 6.0],
        };
        assert_eq!(loss.changes(1), [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 4.0, 11.0, 6.0]);
    }

    #[test]
    fn clearance_is_zero_where_a_flow_is_horizontal_or_on_its_radius() {
        let exact = Clearance::new(&Perturbed::exact(&scenes::generic()));
        assert!(exact.radial < 1e-12 && exact.horizontal > 0.1 && exact.divisor > 0.01, "{exact:?}");
        let off = Clearance::new(&scenes::perturbed_generic());
        assert!(off.radial > 1e-9, "{off:?}");
    }
}
