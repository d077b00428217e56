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

/// The two tests that most claims have, for their comparison of one [`Case`]: everywhere, and at the limits.
macro_rules! tests_on_cases {
    ($at:path) => {
        proptest::proptest! {
            #[test]
            fn holds_everywhere(case in $crate::ledger::testing::case()) {
                $crate::ledger::testing::holds(|f| $at(&case, f))?;
            }

            #[test]
            fn holds_at_the_limits(case in $crate::ledger::testing::limit()) {
                $crate::ledger::testing::holds(|f| $at(&case, f))?;
            }
        }
    };
}

pub(crate) use tests_on_cases;
