//! Ranges of the settings of the four geometric losses.

use dimode_geometry::losses::LossOptions;

use super::ConfigError;
use super::error::{fraction, not_negative, positive};

/// **Errors** [`ConfigError::Value`] for the first value out of range.
pub(super) fn validate(options: &LossOptions) -> Result<(), ConfigError> {
    not_negative("loss.geometric.tau_flow", options.tau_flow)?;
    not_negative("loss.geometric.tau_ratio", options.tau_ratio)?;
    not_negative("loss.geometric.q_min", options.q_min)?;
    positive("loss.geometric.gate", options.gate)?;
    not_negative("loss.geometric.min_tangential_flow", options.min_tangential_flow)?;
    fraction("loss.geometric.min_tangential_share", options.min_tangential_share)?;
    not_negative("loss.geometric.smooth_pixels", options.smooth_pixels)?;
    not_negative("loss.geometric.noise_pixels", options.noise_pixels)?;
    fraction("loss.geometric.noise_share", options.noise_share)?;
    fraction("loss.geometric.min_valid_share", options.min_valid_share)?;
    positive("loss.geometric.tau_translation", options.tau_translation)?;
    fraction("loss.geometric.kappa", options.kappa)?;
    positive("loss.geometric.z_min", options.z_min)
}
