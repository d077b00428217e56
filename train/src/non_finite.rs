//! What to say when a loss, a gradient, a weight or a prediction is not finite: which term, which step, which sample.

use crate::batch::Batch;

const ADVICE: &str = "the last checkpoint stays; lower train.learning_rate, or choose another form of this term in \
     [loss.geometric]: in config.toml of the run, then go on with --resume, or begin again with --force";

/// A step that could not be taken; weights and optimiser are as before it.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("step {step}: the {what} of {term} is not finite{}; {advice}", place(.samples))]
pub struct NonFinite {
    /// Step, counted from 1 as in the log.
    pub step: u64,
    /// `value` or `gradient` of a term, `square` of a weight.
    pub what: &'static str,
    /// Name of the loss term, the weight or the prediction.
    pub term: String,
    /// Name of the first sample where it can be seen; all samples of the batch when it cannot be told; none where samples have no
    /// names.
    pub samples: Vec<String>,
    /// What was saved, and what to do.
    pub advice: &'static str,
}

fn place(samples: &[String]) -> String {
    match samples {
        [] => String::new(),
        [name] => format!(" (first in sample {name})"),
        names => format!(" (batch of samples {})", names.join(", ")),
    }
}

/// A term or a weight that is not finite, before step and names are known.
#[derive(Clone, Debug, PartialEq)]
pub struct Failure {
    /// `value` or `gradient` of a term, `square` of a weight.
    pub what: &'static str,
    /// Name of the term or of the weight.
    pub term: String,
    /// First sample of the batch where it can be seen.
    pub sample: Option<usize>,
}

impl Failure {
    /// The error with sample names; `step` counts from 0.
    pub(crate) fn at(self, step: u64, batch: &Batch) -> NonFinite {
        let samples = self.sample.map_or_else(|| batch.names.clone(), |i| vec![batch.names[i].clone()]);
        NonFinite { step: step + 1, what: self.what, term: self.term, samples, advice: ADVICE }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_message_names_step_term_and_sample() {
        let samples = vec!["00/000007".to_owned()];
        let error = NonFinite { step: 12, what: "gradient", term: "l_pla".into(), samples, advice: "lower the rate" };
        let text = error.to_string();
        assert!(text.starts_with("step 12: the gradient of l_pla is not finite (first in sample 00/000007); "), "{text}");
        let samples = vec!["00/000007".to_owned(), "01/000002".to_owned()];
        assert!(NonFinite { samples, ..error.clone() }.to_string().contains("(batch of samples 00/000007, 01/000002)"));
        let text = NonFinite { samples: Vec::new(), ..error }.to_string();
        assert_eq!(text, "step 12: the gradient of l_pla is not finite; lower the rate");
    }
}
