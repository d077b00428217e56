//! Settings of the four losses.

use serde::{Deserialize, Serialize};

use super::{AxialForm, PlanarForm, RadialForm, StaticMask, TangentialForm};
use crate::alignment::Convention;
use crate::taped::MIN_DEPTH;

/// Forms of the four geometric losses and the guards of their divisions.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LossOptions {
    /// Which translation the alignments remove.
    pub convention: Convention,
    /// Form of `L_pla`.
    pub planar: PlanarForm,
    /// Form of `L_axi`.
    pub axial: AxialForm,
    /// Form of `L_tan`.
    pub tangential: TangentialForm,
    /// Form of `L_rad`.
    pub radial: RadialForm,
    /// Which pixels count as part of the static scene; the caller applies it to [`super::PairInputs::mask`].
    pub static_mask: StaticMask,
    /// Shortest aligned flow whose direction counts, pixels.
    pub tau_flow: f64,
    /// Smallest flow component that a ratio may divide by, pixels.
    pub tau_ratio: f64,
    /// Smallest distance from the principal point for radial directions, pixels.
    pub q_min: f64,
    /// Largest relative error kept by the pixel terms of the `Robust` ratio forms.
    pub gate: f64,
    /// Smallest length a translation is divided by in the aggregate terms, in the unit of depth.
    pub tau_translation: f64,
    /// Smallest component a translation is divided by in the aggregate terms, as a share of its length.
    pub kappa: f64,
    /// Axes x, y, z whose ratios count; a translation that is known to have no component along one says nothing of it. The pixel
    /// forms have no ratios.
    pub axes: [bool; 3],
    /// Shortest predicted tangential flow of the planar pixel form, pixels.
    pub min_tangential_flow: f64,
    /// Smallest share of the translation's length that must be tangential for the planar pixel form: the direction of a
    /// tangential part near zero is noise, and its slope grows as the part shrinks.
    pub min_tangential_share: f64,
    /// Rounding of the tip of absolute values in the pixel forms, pixels; 0 for none.
    pub smooth_pixels: f64,
    /// Error that the flow may have everywhere, pixels: the pixel forms count what a residual has beyond it.
    pub noise_pixels: f64,
    /// The same as a share of the flow's length, on top of `noise_pixels`.
    pub noise_share: f64,
    /// Images with a smaller share of usable pixels are left out of the batch mean.
    pub min_valid_share: f64,
    /// Smallest depth that counts as in front of the camera, depth units.
    pub z_min: f64,
    /// Cuts the gradient that the aligned flows send to the source depth; a property of the pair, so all four
    /// losses of that pair lose it. Build two pairs where only the direction losses should.
    pub detach_source_depth: bool,
    /// Cuts the gradient of the predicted direction in the planar pixel form.
    pub detach_direction: bool,
}

impl Default for LossOptions {
    /// What training uses: residuals in the image, whose gradients are bounded, beyond the noise of a learned flow.
    fn default() -> Self {
        Self {
            convention: Convention::Consistent,
            planar: PlanarForm::PerpendicularPixels,
            axial: AxialForm::PerpendicularPixels,
            tangential: TangentialForm::FlowPixels,
            radial: RadialForm::FlowPixels,
            static_mask: StaticMask::Relative,
            tau_flow: 0.1,
            tau_ratio: 0.1,
            q_min: 1.0,
            gate: 2.0,
            tau_translation: 1e-3,
            kappa: 0.05,
            axes: [true; 3],
            min_tangential_flow: 0.5,
            min_tangential_share: 0.3,
            smooth_pixels: 0.0,
            noise_pixels: 0.5,
            noise_share: 0.15,
            min_valid_share: 0.1,
            z_min: MIN_DEPTH,
            detach_source_depth: true,
            detach_direction: false,
        }
    }
}

impl LossOptions {
    /// The printed equations, with the printed alignment and static mask.
    #[must_use]
    pub fn literal() -> Self {
        Self {
            convention: Convention::AsPrinted,
            planar: PlanarForm::Literal,
            axial: AxialForm::Literal,
            tangential: TangentialForm::Literal,
            radial: RadialForm::Literal,
            static_mask: StaticMask::Mean,
            noise_pixels: 0.0,
            noise_share: 0.0,
            min_valid_share: 0.01,
            detach_source_depth: false,
            ..Self::default()
        }
    }
}
