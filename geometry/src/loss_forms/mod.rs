//! The four geometric losses as plain sums over lists of pixels.
//!
//! These are the definitions; the differentiable versions in [`crate::losses`] are tested against
//! them. No masks and no guards: callers pass usable pixels only. `d` is `p - p0`.

pub mod axial;
pub mod planar;
pub mod radial;
pub mod tangential;

/// Mean of an iterator of known length; 0 for an empty one.
pub(crate) fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len().max(1);
    values.sum::<f64>() / count as f64
}

/// Pixel term `E[|rho a - z| / z]` of eqs. `lt`, `lr`.
pub(crate) fn pixel_term(ratios: &[f64], depths: &[f64], a: f64) -> f64 {
    mean(
        ratios
            .iter()
            .zip(depths)
            .map(|(rho, z)| (rho * a - z).abs() / z),
    )
}

/// Aggregate term `|(E[z / rho] - a) / a|` of eqs. `lt`, `lr`, from inverse ratios.
pub(crate) fn aggregate_term(inverse_ratios: &[f64], depths: &[f64], a: f64) -> f64 {
    let recovered = mean(inverse_ratios.iter().zip(depths).map(|(i, z)| i * z));
    ((recovered - a) / a).abs()
}
