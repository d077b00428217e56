//! Property tests of claims: the same comparisons as in the ledger, on cases that proptest chooses and shrinks.

use proptest::prelude::*;

use super::{Case, DIMENSIONS, Findings};

/// A default case.
pub fn case() -> impl Strategy<Value = Case> {
    prop::array::uniform24(0.0f64..1.0)
        .prop_filter_map("the ray leaves the source camera", |x: [f64; DIMENSIONS]| Case::from_unit(&x))
}

/// A default case taken to one of its limits.
pub fn limit() -> impl Strategy<Value = Case> {
    (case(), 0..Case::LIMITS).prop_map(|(case, number)| case.limit(number))
}

/// Runs one comparison; an error names every residual and derivative out of bounds. Gaps are not asked for: one case need not be
/// a counter-example.
pub fn holds(compare: impl FnOnce(&mut Findings)) -> Result<(), TestCaseError> {
    let mut findings = Findings::default();
    compare(&mut findings);
    let violations = findings.violations();
    if violations.is_empty() { Ok(()) } else { Err(TestCaseError::fail(violations.join("; "))) }
}
