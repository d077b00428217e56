//! Forms of the four geometric losses and the guards of their divisions.

use dimode_geometry::alignment;
use dimode_geometry::losses::{self, LossOptions};
use serde::{Deserialize, Serialize};

use super::ConfigError;
use super::error::{fraction, not_negative, positive};

/// Which translation the alignments remove.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Convention {
    /// The translation expressed in the target frame: all losses are 0 at the true depth, motion and flow.
    #[default]
    Consistent,
    /// The last column of the transform, as the equations are printed.
    AsPrinted,
}

/// Form of the planar loss.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PlanarForm {
    /// Pixels by which the planar flow leaves the predicted tangential direction.
    #[default]
    PerpendicularPixels,
    /// Circular variance of the directions.
    Circular,
    /// Circular variance, long flows counting more.
    Weighted,
    /// The printed variance of the angle, over flows long enough to have one.
    Robust,
    /// Variance of the angle, as printed.
    Literal,
}

/// Form of the axial loss.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum AxialForm {
    /// Pixels by which the axial flow leaves the line through the principal point.
    #[default]
    PerpendicularPixels,
    /// Mean angle between lines, the same for approaching and receding motion.
    Folded,
    /// Mean angle to the direction that the sign of the predicted motion asks for.
    PoseSign,
    /// The printed angle, over flows long enough to have one.
    Signed,
    /// Mean angle, as printed.
    Literal,
}

/// Form of the tangential loss.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TangentialForm {
    /// Recovered translation `z / rho` against the predicted one.
    InverseRatio,
    /// Predicted against observed planar flow, in pixels.
    #[default]
    FlowPixels,
    /// The printed ratios with gates against tiny flow.
    Robust,
    /// The ratios as printed.
    Literal,
}

/// Form of the radial loss.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RadialForm {
    /// Recovered translation `z / rho` against the predicted one.
    InverseRatio,
    /// Predicted against observed axial flow, in pixels.
    #[default]
    FlowPixels,
    /// The printed ratio with gates against tiny flow.
    Robust,
    /// The ratio as printed.
    Literal,
}

/// Which pixels count as part of the static scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StaticMask {
    /// All.
    None,
    /// Squared difference of rigid and optical flow below its mean over the image.
    Mean,
    /// Squared difference relative to the flow below four times its mean: large flows may be far off at first.
    #[default]
    Relative,
}

impl From<PlanarForm> for losses::PlanarVariant {
    fn from(form: PlanarForm) -> Self {
        match form {
            PlanarForm::PerpendicularPixels => Self::PerpendicularPixels,
            PlanarForm::Circular => Self::Circular,
            PlanarForm::Weighted => Self::Weighted,
            PlanarForm::Robust => Self::Robust,
            PlanarForm::Literal => Self::Literal,
        }
    }
}

impl From<AxialForm> for losses::AxialVariant {
    fn from(form: AxialForm) -> Self {
        match form {
            AxialForm::PerpendicularPixels => Self::PerpendicularPixels,
            AxialForm::Folded => Self::Folded,
            AxialForm::PoseSign => Self::PoseSign,
            AxialForm::Signed => Self::Signed,
            AxialForm::Literal => Self::Literal,
        }
    }
}

impl From<TangentialForm> for losses::TangentialVariant {
    fn from(form: TangentialForm) -> Self {
        match form {
            TangentialForm::InverseRatio => Self::InverseRatio,
            TangentialForm::FlowPixels => Self::FlowPixels,
            TangentialForm::Robust => Self::Robust,
            TangentialForm::Literal => Self::Literal,
        }
    }
}

impl From<RadialForm> for losses::RadialVariant {
    fn from(form: RadialForm) -> Self {
        match form {
            RadialForm::InverseRatio => Self::InverseRatio,
            RadialForm::FlowPixels => Self::FlowPixels,
            RadialForm::Robust => Self::Robust,
            RadialForm::Literal => Self::Literal,
        }
    }
}

/// Forms of the four geometric losses and the guards of their divisions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GeometricConfig {
    /// Which translation the alignments remove.
    pub convention: Convention,
    /// Form of the planar loss.
    pub planar: PlanarForm,
    /// Form of the axial loss.
    pub axial: AxialForm,
    /// Form of the tangential loss.
    pub tangential: TangentialForm,
    /// Form of the radial loss.
    pub radial: RadialForm,
    /// Which pixels count as part of the static scene.
    pub static_mask: StaticMask,
    /// Shortest flow whose direction counts, in pixels.
    pub tau_flow: f64,
    /// Smallest flow component that a ratio may divide by, in pixels.
    pub tau_ratio: f64,
    /// Smallest distance from the principal point, in pixels.
    pub q_min: f64,
    /// Largest relative error kept by the pixel terms of the robust ratio forms.
    pub gate: f64,
    /// Smallest length a translation is divided by, in the unit of depth.
    pub tau_translation: f64,
    /// Smallest component a translation is divided by, as a share of its length.
    pub kappa: f64,
    /// Shortest predicted tangential flow of the planar pixel form, in pixels.
    pub min_tangential_flow: f64,
    /// Smallest tangential share of a translation for the planar pixel form to say anything about its image.
    pub min_tangential_share: f64,
    /// Rounding of the tip of absolute values in the pixel forms, in pixels; 0 for none.
    pub smooth_pixels: f64,
    /// Error that the flow may have everywhere, in pixels; the pixel forms count what a residual has beyond it.
    pub noise_pixels: f64,
    /// The same as a share of the flow's length, on top of `noise_pixels`.
    pub noise_share: f64,
    /// Images with a smaller share of usable pixels are left out of a batch's mean.
    pub min_valid_share: f64,
    /// Smallest depth after alignment.
    pub z_min: f64,
    /// Send no gradient into the depth of the source frame.
    pub detach_source_depth: bool,
    /// Send no gradient into the direction that perpendicular residuals are measured against.
    pub detach_direction: bool,
}

impl Default for GeometricConfig {
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
            min_tangential_flow: 0.5,
            min_tangential_share: 0.3,
            smooth_pixels: 0.0,
            noise_pixels: 0.5,
            noise_share: 0.15,
            min_valid_share: 0.1,
            z_min: 1e-3,
            detach_source_depth: true,
            detach_direction: false,
        }
    }
}

impl GeometricConfig {
    /// The four losses exactly as printed, for comparison.
    pub fn literal() -> Self {
        Self {
            convention: Convention::AsPrinted,
            planar: PlanarForm::Literal,
            axial: AxialForm::Literal,
            tangential: TangentialForm::Literal,
            radial: RadialForm::Literal,
            static_mask: StaticMask::Mean,
            min_valid_share: 0.01,
            noise_pixels: 0.0,
            noise_share: 0.0,
            detach_source_depth: false,
            ..Self::default()
        }
    }

    /// The same choices as the losses take them.
    pub fn options(&self) -> LossOptions {
        LossOptions {
            convention: match self.convention {
                Convention::Consistent => alignment::Convention::Consistent,
                Convention::AsPrinted => alignment::Convention::AsPrinted,
            },
            planar: self.planar.into(),
            axial: self.axial.into(),
            tangential: self.tangential.into(),
            radial: self.radial.into(),
            tau_f: self.tau_flow,
            tau_rho: self.tau_ratio,
            q_min: self.q_min,
            gate: self.gate,
            tau_t: self.tau_translation,
            kappa: self.kappa,
            z_min: self.z_min,
            min_tangential_flow: self.min_tangential_flow,
            min_tangential_share: self.min_tangential_share,
            smooth_px: self.smooth_pixels,
            noise_px: self.noise_pixels,
            noise_share: self.noise_share,
            detach_depth_in_alignment: self.detach_source_depth,
            detach_direction: self.detach_direction,
            min_valid_fraction: self.min_valid_share,
        }
    }

    /// **Errors** [`ConfigError::Value`] for the first value out of range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        not_negative("loss.geometric.tau_flow", self.tau_flow)?;
        not_negative("loss.geometric.tau_ratio", self.tau_ratio)?;
        not_negative("loss.geometric.q_min", self.q_min)?;
        positive("loss.geometric.gate", self.gate)?;
        not_negative("loss.geometric.min_tangential_flow", self.min_tangential_flow)?;
        fraction("loss.geometric.min_tangential_share", self.min_tangential_share)?;
        not_negative("loss.geometric.smooth_pixels", self.smooth_pixels)?;
        not_negative("loss.geometric.noise_pixels", self.noise_pixels)?;
        fraction("loss.geometric.noise_share", self.noise_share)?;
        fraction("loss.geometric.min_valid_share", self.min_valid_share)?;
        positive("loss.geometric.tau_translation", self.tau_translation)?;
        fraction("loss.geometric.kappa", self.kappa)?;
        positive("loss.geometric.z_min", self.z_min)
    }
}
