//! What is not a number must show: an operation that hides it returns a wrong number.

use super::{Case, Dual, Plain, Proof};
use crate::Tensor;

/// Entries tried for each input.
const TRIED: usize = 12;

impl Proof {
    /// The places where one input entry that is not a number leaves an output entry a number though it depends on it.
    ///
    /// What an output depends on is read from its derivative, so an entry that is not selected (by a mask, an index, an extremum)
    /// may be anything.
    pub fn hidden_nan(&self) -> Vec<String> {
        self.cases.iter().flat_map(Case::hidden_nan).collect()
    }
}

impl Case {
    fn hidden_nan(&self) -> Vec<String> {
        let mut found = Vec::new();
        let mut inputs: Vec<Plain<Dual>> = self.inputs.iter().map(Plain::of).collect();
        for k in (0..inputs.len()).filter(|&k| self.moves[k]) {
            let len = inputs[k].data.len();
            for i in (0..len).step_by(len.div_ceil(TRIED)) {
                inputs[k].data[i].slope = 1.0;
                let depends = self.subject.tangent(&inputs);
                inputs[k].data[i].slope = 0.0;
                let spoiled = self.value_with_nan(k, i);
                let hidden = depends.data.iter().zip(spoiled.data()).position(|(y, got)| y.slope != 0.0 && !got.is_nan());
                found.extend(hidden.map(|at| format!("{}: input {k} entry {i}, output entry {at}", self.label())));
            }
        }
        found
    }

    /// The value where entry `i` of input `k` is not a number.
    fn value_with_nan(&self, k: usize, i: usize) -> Tensor<f64> {
        let mut inputs = self.inputs.clone();
        inputs[k].make_mut()[i] = f64::NAN;
        self.value(&inputs)
    }
}
