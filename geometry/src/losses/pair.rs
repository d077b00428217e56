//! One batch of aligned (target, source) pairs: what the four losses read.

use dimode_autodiff::ops::bilinear_sample::SamplePadding;
use dimode_autodiff::ops::kernel;
use dimode_autodiff::{Scalar, Shape, Tensor, Var};

use super::options::LossOptions;
use crate::alignment::Convention;
use crate::camera::Intrinsics;
use crate::taped::smooth::length;
use crate::taped::{align, masks, translation_in_target_frame, warp};

/// Inputs of a batch of pairs.
#[derive(Clone, Copy, Debug)]
pub struct PairInputs<'a, 't, T: Scalar> {
    /// Depth of the target view, (N,1,H,W).
    pub target_depth: Var<'t, T>,
    /// Depth of the source view, on its own pixel grid, (N,1,H,W).
    pub source_depth: Var<'t, T>,
    /// Optical flow from target to source, (N,2,H,W), pixels.
    pub flow: Var<'t, T>,
    /// Rotation of `source_from_target`, (N,1,3,3).
    pub rotation: Var<'t, T>,
    /// Translation of `source_from_target`, (N,3,1,1).
    pub translation: Var<'t, T>,
    /// Camera of every sample, at the size of the maps.
    pub intrinsics: &'a [Intrinsics],
    /// Pixels to use, for example static and not occluded, (N,1,H,W): 0 or 1, or weights in between.
    pub mask: &'a Tensor<T>,
}

/// Aligned flows of a batch and everything the losses need beside them.
#[derive(Clone, Debug)]
pub struct AlignedPair<'t, T: Scalar> {
    /// Planar flow `f_pla`, (N,2,H,W), pixels.
    pub planar_flow: Var<'t, T>,
    /// Axial flow `f_axi`, (N,2,H,W), pixels.
    pub axial_flow: Var<'t, T>,
    /// Depth after the planar alignment, (N,1,H,W).
    pub planar_depth: Var<'t, T>,
    /// Depth after the axial alignment, (N,1,H,W).
    pub axial_depth: Var<'t, T>,
    /// Target depth, (N,1,H,W).
    pub target_depth: Var<'t, T>,
    /// Translation `a` that was split, (N,3,1,1).
    pub translation: Var<'t, T>,
    /// Pixels of the given mask with all depths in front of the camera and finite flows, (N,1,H,W).
    pub mask: Tensor<T>,
    /// Offsets `p - p0` along u, (N,1,H,W), pixels.
    pub(crate) d_u: Tensor<T>,
    /// Offsets `p - p0` along v.
    pub(crate) d_v: Tensor<T>,
    /// Distances `|p - p0|`, (N,1,H,W), pixels.
    pub(crate) radius: Tensor<T>,
    /// Residual that the flow's own error may cause, `noise_pixels + noise_share |f|`, (N,1,H,W), pixels; none when both are 0.
    noise: Option<Var<'t, T>>,
    /// Focal lengths along u, (N,1,1,1).
    pub(crate) focal_u: Tensor<T>,
    /// Focal lengths along v.
    pub(crate) focal_v: Tensor<T>,
}

impl<'t, T: Scalar> AlignedPair<'t, T> {
    /// Samples the source depth at the flow's ends (bilinear, border), aligns, and drops pixels that leave the view.
    ///
    /// **Panics** when a shape does not fit.
    #[must_use]
    #[track_caller]
    pub fn new(inputs: &PairInputs<'_, 't, T>, options: &LossOptions) -> Self {
        let flow = inputs.flow;
        let sampled = warp(inputs.source_depth, flow, SamplePadding::Border);
        let mask = masks::all_of(&[inputs.mask, &masks::in_view(&flow.value())]);
        Self::from_sampled(&PairInputs { source_depth: sampled, mask: &mask, ..*inputs }, options)
    }

    /// As [`AlignedPair::new`] with `source_depth` already given at the flow's ends.
    ///
    /// The mask is narrowed by the depths only: in view is the caller's business.
    /// **Panics** when a shape does not fit.
    #[must_use]
    #[track_caller]
    pub fn from_sampled(inputs: &PairInputs<'_, 't, T>, options: &LossOptions) -> Self {
        let source_depth = match options.detach_source_depth {
            true => inputs.source_depth.detach(),
            false => inputs.source_depth,
        };
        let translation = match options.convention {
            Convention::AsPrinted => inputs.translation,
            Convention::Consistent => translation_in_target_frame(inputs.rotation, inputs.translation),
        };
        let aligned = align(source_depth, inputs.rotation, translation, inputs.flow, inputs.intrinsics);
        let mask = usable(&aligned.value(), &source_depth.value(), inputs.mask, options.z_min);
        let shape = source_depth.shape();
        let per_image = Shape::new(shape.n(), 1, 1, 1);
        let k = inputs.intrinsics;
        let d_u = Tensor::from_fn(shape, |n, _, _, u| T::from_f64(u as f64 - k[n].u0));
        let d_v = Tensor::from_fn(shape, |n, _, v, _| T::from_f64(v as f64 - k[n].v0));
        let mut radius = vec![T::ZERO; shape.len()];
        kernel::zip(&mut radius, d_u.data(), d_v.data(), |x, y| (x * x + y * y).sqrt());
        let radius = Tensor::from_vec(shape, radius);
        Self {
            planar_flow: aligned.slice(1, 0, 2),
            axial_flow: aligned.slice(1, 2, 2),
            planar_depth: aligned.slice(1, 4, 1),
            axial_depth: aligned.slice(1, 5, 1),
            target_depth: inputs.target_depth,
            translation,
            mask,
            d_u,
            d_v,
            radius,
            noise: noise(inputs.flow, options),
            focal_u: Tensor::from_fn(per_image, |n, _, _, _| T::from_f64(k[n].fu)),
            focal_v: Tensor::from_fn(per_image, |n, _, _, _| T::from_f64(k[n].fv)),
        }
    }

    /// Shape (N,1,H,W) of the maps.
    pub(crate) fn map_shape(&self) -> Shape {
        self.target_depth.shape()
    }

    /// Component `k` of the translation, (N,1,1,1).
    pub(crate) fn a(&self, k: usize) -> Var<'t, T> {
        self.translation.slice(1, k, 1)
    }

    /// A per-image number at every pixel.
    pub(crate) fn spread(&self, x: Var<'t, T>) -> Var<'t, T> {
        x.broadcast_to(self.map_shape())
    }

    /// A constant on the tape.
    pub(crate) fn constant(&self, x: &Tensor<T>) -> Var<'t, T> {
        self.translation.tape().constant(x.clone())
    }

    /// `x` inside the mask, the constant `filler` outside.
    pub(crate) fn keep(&self, x: Var<'t, T>, mask: &Tensor<T>, filler: f64) -> Var<'t, T> {
        x.select(mask, self.constant(&Tensor::full(x.shape(), T::from_f64(filler))))
    }

    /// What a residual, in pixels, has beyond the flow's own error: `max(r - noise_pixels - noise_share |f|, 0)`.
    pub(crate) fn beyond_noise(&self, residual: Var<'t, T>) -> Var<'t, T> {
        match self.noise {
            Some(noise) => residual.sub(noise).relu(),
            None => residual,
        }
    }

    /// `d . f` of the axial flow, (N,1,H,W), with flows outside the mask replaced by `d` itself.
    pub(crate) fn axial_products(&self, mask: &Tensor<T>) -> AxialProducts<'t, T> {
        let (d_u, d_v) = (self.constant(&self.d_u), self.constant(&self.d_v));
        let f_u = self.axial_flow.slice(1, 0, 1).select(mask, d_u);
        let f_v = self.axial_flow.slice(1, 1, 1).select(mask, d_v);
        AxialProducts { along: d_u.mul(f_u).add(d_v.mul(f_v)), across: d_u.mul(f_v).sub(d_v.mul(f_u)) }
    }

    /// Distances from the principal point, (N,1,H,W), at least `floor`.
    pub(crate) fn radius_from(&self, floor: f64) -> Tensor<T> {
        let floor = T::from_f64(floor);
        let mut out = vec![T::ZERO; self.map_shape().len()];
        kernel::map(&mut out, self.radius.data(), |r| r.max(floor));
        Tensor::from_vec(self.map_shape(), out)
    }
}

/// Products of `d = p - p0` with the axial flow.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AxialProducts<'t, T: Scalar> {
    /// `d . f`.
    pub along: Var<'t, T>,
    /// `d x f`.
    pub across: Var<'t, T>,
}

/// `noise_pixels + noise_share |f|`, (N,1,H,W).
fn noise<'t, T: Scalar>(flow: Var<'t, T>, options: &LossOptions) -> Option<Var<'t, T>> {
    let any = options.noise_pixels > 0.0 || options.noise_share > 0.0;
    any.then(|| {
        let size = length(flow.slice(1, 0, 1), flow.slice(1, 1, 1), 0.0);
        size.scale(options.noise_share).add_scalar(options.noise_pixels)
    })
}

/// The mask with all depths above `z_min` and finite aligned flows.
fn usable<T: Scalar>(aligned: &Tensor<T>, source_depth: &Tensor<T>, mask: &Tensor<T>, z_min: f64) -> Tensor<T> {
    let z_min = T::from_f64(z_min);
    masks::and_where(mask, |n| {
        let depths = [source_depth.plane(n, 0), aligned.plane(n, 4), aligned.plane(n, 5)];
        let flows = [0, 1, 2, 3].map(|c| aligned.plane(n, c));
        move |i| depths.iter().all(|z| z[i] > z_min) && flows.iter().all(|f| f[i].is_finite())
    })
}
