//! `l_rc`, `l_rt`: what a network that removes rotation is trained by, beside the losses of the images that it makes.

use dimode_autodiff::Var;

use super::report::{LossReport, TermReport};
use crate::config::LossConfig;
use crate::non_finite::Failure;
use crate::rectification::RectifiedSources;

/// Adds both terms to a report and gives their weighted sum.
///
/// # Errors
/// When one is not finite.
pub(crate) fn measure<'t>(
    loss: &LossConfig,
    rectified: &RectifiedSources<'t>,
    report: &mut LossReport,
) -> Result<Var<'t, f32>, Failure> {
    let terms = [("l_rc", loss.rotation_consistency, rectified.consistency), ("l_rt", loss.rotation_triplet, rectified.triplet)];
    for (name, weight, term) in terms {
        let value = f64::from(term.value().item());
        if !value.is_finite() {
            return Err(Failure { what: "value", term: name.to_owned(), sample: None });
        }
        report.total += weight * value;
        report.terms.push(TermReport::new(name, weight, value, 1.0));
    }
    let [consistency, triplet] = terms.map(|(_, weight, term)| term.scale(weight));
    Ok(consistency.add(triplet))
}
