//! What to say when a loss or a gradient is not finite: which term, which step, which sample.

use crate::batch::Batch;

const ADVICE: &str =
    "nothing of this step was kept; lower train.learning_rate, or choose a robust form of this term in [loss.geometric]";

/// A step that could not be taken; weights and optimiser are as before it.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("step {step}: the {what} of {term} is not finite ({}); {advice}", place(.sample.as_deref()), advice = ADVICE)]
pub struct NonFinite {
    /// Step, from 0.
    pub step: u64,
    /// `value` or `gradient`.
    pub what: &'static str,
    /// Name of the loss term.
    pub term: String,
    /// Name of the first sample where it can be seen.
    pub sample: Option<String>,
}

fn place(sample: Option<&str>) -> String {
    sample.map_or_else(|| "in no single sample of the batch".to_owned(), |name| format!("first in sample {name}"))
}

/// A term that is not finite, before step and names are known.
#[derive(Clone, Debug, PartialEq)]
pub struct Failure {
    /// `value` or `gradient`.
    pub what: &'static str,
    /// Name of the term.
    pub term: String,
    /// First sample of the batch where it can be seen.
    pub sample: Option<usize>,
}

impl Failure {
    /// The error with step and sample name.
    pub(crate) fn at(self, step: u64, batch: &Batch) -> NonFinite {
        NonFinite { step, what: self.what, term: self.term, sample: self.sample.map(|i| batch.names[i].clone()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_message_names_step_term_and_sample() {
        let sample = Some("00/000007".to_owned());
        let error = NonFinite { step: 12, what: "gradient", term: "l_pla".into(), sample };
        let text = error.to_string();
        assert!(text.starts_with("step 12: the gradient of l_pla is not finite (first in sample 00/000007); "), "{text}");
        assert!(NonFinite { sample: None, ..error }.to_string().contains("in no single sample"));
    }
}
