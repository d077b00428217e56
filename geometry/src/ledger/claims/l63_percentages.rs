//! L63: the reductions of the trajectory error in the text.

use crate::ledger::{Claim, Findings, Trial, Verdict};
use crate::reported::{TRAJECTORY_REDUCTIONS, reduction_percent};

pub(super) static CLAIM: Claim = Claim {
    id: "L63",
    slug: "percentages",
    place: "Sect. VI",
    statement: "The absolute trajectory error falls by 75.05, 65.30, 52.11 and 54.56 %.",
    verdict: Verdict::Exact,
    condition: Some("to the two decimals that are printed"),
    formula: "100 (before - after) / before",
    derivation: "From the table: 43.17 to 10.77, 50.72 to 17.60, 13.51 to 6.47, 22.03 to 10.01 m give 75.0521, 65.2997, \
                 52.1095, 54.5620 %.",
    counter_example: None,
    correction: None,
    functions: &["reported::reduction_percent"],
    taped: &[],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    let recomputed = [75.0521195274, 65.2996845426, 52.1095484826, 54.5619609623];
    for (reduction, expected) in TRAJECTORY_REDUCTIONS.into_iter().zip(recomputed) {
        let percent = reduction_percent(reduction.before, reduction.after);
        let f = &mut trial.findings;
        // Half of the last printed digit; 1e-9 for its rounding in binary.
        f.documented_within("percentage in the text, two decimals", percent, reduction.percent, 0.005 + 1e-9);
        f.documented("percentage from the table, documented", percent, expected, 1e-11);
        both_ways(reduction.before, percent, reduction.after, f);
        trial.count(1);
    }
}

/// What is left after the percentage comes off is the error after.
fn both_ways(before: f64, percent: f64, after: f64, f: &mut Findings) {
    f.equal("before (1 - percent / 100) - after, relative", before * (1.0 - percent / 100.0), after, before + after, 1e-14);
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::ledger::testing::holds;

    proptest! {
        #[test]
        fn a_reduction_can_be_taken_off_again(before in 0.1f64..100.0, after in 0.0f64..100.0) {
            holds(|f| both_ways(before, reduction_percent(before, after), after, f))?;
        }
    }
}
