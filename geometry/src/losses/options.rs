//! Settings of the four losses.

use super::{AxialVariant, PlanarVariant, RadialVariant, TangentialVariant};
use crate::alignment::Convention;
use crate::taped::MIN_DEPTH;

/// Which forms of the losses to use, and their thresholds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LossOptions {
    /// Translation that the alignment splits.
    pub convention: Convention,
    /// Form of `L_pla`.
    pub planar: PlanarVariant,
    /// Form of `L_axi`.
    pub axial: AxialVariant,
    /// Form of `L_tan`.
    pub tangential: TangentialVariant,
    /// Form of `L_rad`.
    pub radial: RadialVariant,
    /// Shortest aligned flow whose direction counts, pixels.
    pub tau_f: f64,
    /// Smallest flow component that a ratio may divide by, pixels.
    pub tau_rho: f64,
    /// Smallest distance from the principal point for radial directions, pixels.
    pub q_min: f64,
    /// Largest relative error kept by the pixel terms of the robust ratio losses.
    pub gate: f64,
    /// Smallest denominator of the aggregate terms, translation units.
    pub tau_t: f64,
    /// Smallest denominator of the aggregate terms as a part of the translation's length.
    pub kappa: f64,
    /// Smallest depth that counts as in front of the camera, depth units.
    pub z_min: f64,
    /// Shortest predicted tangential flow of the planar pixel form, pixels.
    pub min_tangential_flow: f64,
    /// Smallest share of the translation's length that must be tangential for the planar pixel form: the direction of a
    /// tangential part near zero is noise, and its slope grows as the part shrinks.
    pub min_tangential_share: f64,
    /// Rounding of the tip of absolute values in the pixel forms, pixels; 0 for none.
    pub smooth_px: f64,
    /// Error that the flow may have everywhere, pixels: the pixel forms count what a residual has beyond it.
    pub noise_px: f64,
    /// The same as a part of the flow's length, on top of `noise_px`.
    pub noise_share: f64,
    /// Cuts the gradient that the aligned flows send to the source depth; a property of the pair, so all four
    /// losses of that pair lose it. Build two pairs where only the direction losses should.
    pub detach_depth_in_alignment: bool,
    /// Cuts the gradient of the predicted direction in the planar pixel form.
    pub detach_direction: bool,
    /// Images with a smaller part of usable pixels are left out of the batch mean.
    pub min_valid_fraction: f64,
}

impl LossOptions {
    /// The printed equations, with the printed alignment.
    #[must_use]
    pub fn literal() -> Self {
        Self {
            convention: Convention::AsPrinted,
            planar: PlanarVariant::Literal,
            axial: AxialVariant::Literal,
            tangential: TangentialVariant::Literal,
            radial: RadialVariant::Literal,
            ..Self::robust()
        }
    }

    /// The printed quantities with every hazard masked; equal to them where all pixels pass.
    #[must_use]
    pub fn robust() -> Self {
        Self {
            convention: Convention::Consistent,
            planar: PlanarVariant::Robust,
            axial: AxialVariant::Folded,
            tangential: TangentialVariant::Robust,
            radial: RadialVariant::Robust,
            tau_f: 0.1,
            tau_rho: 0.1,
            q_min: 1.0,
            gate: 2.0,
            tau_t: 1e-3,
            kappa: 0.05,
            z_min: MIN_DEPTH,
            min_tangential_flow: 0.5,
            min_tangential_share: 0.0,
            smooth_px: 0.0,
            noise_px: 0.0,
            noise_share: 0.0,
            detach_depth_in_alignment: false,
            detach_direction: false,
            min_valid_fraction: 0.01,
        }
    }

    /// The same equations as residuals in the image: bounded gradients, noise independent of the pixel.
    #[must_use]
    pub fn pixels() -> Self {
        Self {
            planar: PlanarVariant::PerpendicularPixels,
            axial: AxialVariant::PerpendicularPixels,
            tangential: TangentialVariant::FlowPixels,
            radial: RadialVariant::FlowPixels,
            ..Self::robust()
        }
    }
}

impl Default for LossOptions {
    fn default() -> Self {
        Self::robust()
    }
}
