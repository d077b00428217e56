//! A term of the loss: what it needs, how it is measured.

use dimode_autodiff::Var;

use super::needs::Needs;
use super::report::ImageReport;
use super::scene::Scene;
use crate::config::{LossConfig, StageConfig};

/// One entry of the index of terms; it may measure several that go together.
pub(super) struct TermKind {
    /// What it needs under these settings; nothing when it is off.
    pub needs: fn(&LossConfig, &StageConfig) -> Needs,
    /// Its terms on the tape of the scene; none when it is off.
    pub measure: for<'l> fn(&Scene<'_, 'l>) -> Vec<Term<'l>>,
}

/// A measured term.
pub(super) struct Term<'l> {
    /// Name in logs, as in the paper where it has one.
    pub name: &'static str,
    /// Weight in the total.
    pub weight: f64,
    /// Value before weighting, one number.
    pub value: Var<'l, f32>,
    /// Share of pixels that counted.
    pub valid: f64,
    /// Value and pixels of each image and source, where the term keeps them apart.
    pub images: Vec<ImageReport>,
}

impl<'l> Term<'l> {
    /// A term without values of single images.
    pub fn new(name: &'static str, weight: f64, value: Var<'l, f32>, valid: f64) -> Self {
        Term { name, weight, value, valid, images: Vec::new() }
    }
}

/// For terms that need nothing.
pub(super) fn no_needs(_: &LossConfig, _: &StageConfig) -> Needs {
    Needs::default()
}
