//! L64: two slips in counts and tables.

use crate::ledger::{Claim, Trial, Verdict};
use crate::reported::{BOLD_OF_SEQUENCE_15, EIGEN_SPLIT, exchanged_digits};

pub(super) static CLAIM: Claim = Claim {
    id: "L64",
    slug: "counts",
    place: "Sect. VI",
    statement: "The Eigen split has 39,180 training and 4,424 validation triplets; on sequence 15 the value 9.74 is the best of \
                its column.",
    verdict: Verdict::Fails,
    condition: None,
    formula: "39,810 lines of training, 4,424 of validation;  6.57 < 9.74",
    derivation: "Counts of documents, not of this project: read from the published list of that name (splits/eigen_zhou of \
                 monodepth2) and from the paper's table of sequences 11 to 20, where bold marks the smallest of a column. \
                 39,180 is 39,810 with two neighbouring digits exchanged; the number for validation agrees.",
    counter_example: Some("39,810 lines against 39,180 in the text; DF-VO has 6.57 in the column in which 9.74 is bold."),
    correction: Some("39,810 training triplets; bold belongs to 6.57."),
    functions: &["reported::exchanged_digits"],
    taped: &[],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    let f = &mut trial.findings;
    let [training, validation] = EIGEN_SPLIT;
    f.gap("training triplets: printed - listed", f64::from(training.printed) - f64::from(training.listed), 0.9 * 630.0);
    f.residual("validation triplets: printed - listed", f64::from(validation.printed) - f64::from(validation.listed), 0.0);
    let slip = exchanged_digits(training.printed, training.listed) == Some(('1', '8'));
    f.residual("training triplets other than with two digits exchanged: 1 if so", f64::from(u8::from(!slip)), 0.0);
    let (bold, other) = BOLD_OF_SEQUENCE_15;
    f.gap("sequence 15: bold value - smaller value of the column", (bold - other).max(0.0), 0.9 * 3.17);
    trial.count(EIGEN_SPLIT.len() + 1);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ledger::Settings;

    #[test]
    fn both_slips_show_and_the_rest_agrees() {
        let outcome = CLAIM.verify(&Settings::default());
        assert!(outcome.ok, "{:?}", outcome.contradictions);
        assert_eq!(outcome.findings.len(), 4);
    }
}
