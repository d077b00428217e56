//! Faults planted in backward rules: the test of the checker.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

use super::check::Expected;
use super::{Case, Proof, TOLERANCE};
use crate::{Scalar, Shape};

/// A mistake in what a backward rule writes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Fault {
    /// Every entry times 1 + 1e-5.
    Factor,
    /// Every entry negated.
    Sign,
    /// Two neighbours in memory exchanged.
    Swap,
    /// The last row and the last column of every plane are 0.
    Border,
    /// One entry times 1 + 1e-5.
    Entry,
}

impl Fault {
    /// All faults.
    pub const ALL: [Fault; 5] = [Fault::Factor, Fault::Sign, Fault::Swap, Fault::Border, Fault::Entry];

    /// Spoils a contribution. Returns whether that makes a difference: a fault that moves nothing by more than a thousandth of
    /// its size (an exchange of equal numbers, a border of zeros) is none.
    fn spoil(self, shape: Shape, g: &mut [f64]) -> bool {
        let largest = g.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
        let least = 1e-3 * largest;
        if largest == 0.0 {
            return false;
        }
        // Starts away from both ends, where a check by sample would look first.
        let somewhere = |i: &usize| (i + g.len() * 5 / 8) % g.len();
        match self {
            Fault::Factor => g.iter_mut().for_each(|x| *x *= 1.0 + 1e-5),
            Fault::Sign => g.iter_mut().for_each(|x| *x = -*x),
            Fault::Swap => {
                let at = (0..g.len()).map(|i| somewhere(&i)).find(|&i| i + 1 < g.len() && (g[i] - g[i + 1]).abs() > least);
                let Some(i) = at else { return false };
                g.swap(i, i + 1);
            }
            Fault::Border => {
                let (h, w) = (shape.h(), shape.w());
                let mut moved = false;
                for (i, x) in g.iter_mut().enumerate() {
                    if i % w == w - 1 || i / w % h == h - 1 {
                        moved |= x.abs() > least;
                        *x = 0.0;
                    }
                }
                return moved;
            }
            Fault::Entry => {
                let Some(i) = (0..g.len()).map(|i| somewhere(&i)).find(|&i| g[i].abs() > least) else { return false };
                g[i] *= 1.0 + 1e-5;
            }
        }
        true
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Fault::Factor => "factor",
            Fault::Sign => "sign",
            Fault::Swap => "swap",
            Fault::Border => "border",
            Fault::Entry => "entry",
        })
    }
}

/// Changes a contribution of the given shape in place.
type Spoil<T> = Box<dyn Fn(Shape, &mut [T]) + Send>;

/// Changes what one node of a tape contributes to one of its parents, in place.
pub(crate) struct Planted<T: Scalar> {
    /// Position of the node.
    pub(crate) node: usize,
    /// Which parent.
    pub(crate) parent: usize,
    /// The change.
    pub(crate) spoil: Spoil<T>,
}

/// What became of one fault in one backward rule over all cases of a proof.
#[derive(Clone, Debug)]
pub struct Mutation {
    /// The proof's operation.
    pub op: &'static str,
    /// The rule: name of the node and number of the parent.
    pub rule: (&'static str, usize),
    /// The fault.
    pub fault: Fault,
    /// Cases in which the fault makes a difference.
    pub planted: usize,
    /// Those of them that the forward-mode oracle catches.
    pub caught: usize,
    /// Small cases in which the fault was shown to the differences, at most two.
    pub tried_by_differences: usize,
    /// Those of them that the differences catch.
    pub caught_by_differences: usize,
}

impl Mutation {
    /// Whether some case let the fault pass.
    pub fn is_missed(&self) -> bool {
        self.caught < self.planted || self.caught_by_differences < self.tried_by_differences
    }

    /// Whether the fault makes no difference in any case, as an exchange of entries that are always equal.
    pub fn is_void(&self) -> bool {
        self.planted == 0
    }
}

/// Cases up to this size are shown to the differences.
const MOST_FOR_DIFFERENCES: usize = 120;

/// Plants every fault in every backward rule of the proof's cases.
pub fn mutations(proof: &Proof) -> Vec<Mutation> {
    let mut found: BTreeMap<((&'static str, usize), Fault), Mutation> = BTreeMap::new();
    for case in &proof.cases {
        let expected = Expected::new(case);
        for (node, name, parent) in case.rules() {
            for fault in Fault::ALL {
                let rule = (name, parent);
                let mutation = found.entry((rule, fault)).or_insert(Mutation {
                    op: proof.op,
                    rule,
                    fault,
                    planted: 0,
                    caught: 0,
                    tried_by_differences: 0,
                    caught_by_differences: 0,
                });
                mutation.plant(case, &expected, node, parent);
            }
        }
    }
    found.into_values().collect()
}

impl Mutation {
    fn plant(&mut self, case: &Case, expected: &Expected, node: usize, parent: usize) {
        let (fault, moved) = (self.fault, Arc::new(AtomicBool::new(false)));
        let planted = || {
            let moved = moved.clone();
            Planted { node, parent, spoil: Box::new(move |shape, g: &mut [f64]| moved.store(fault.spoil(shape, g), Relaxed)) }
        };
        let gradients = case.gradients(&case.inputs, &expected.weights[0], Some(planted())).1;
        if moved.load(Relaxed) {
            self.planted += 1;
            self.caught += usize::from(expected.error(0, &gradients) > TOLERANCE);
        }
        if self.tried_by_differences < 2 && case.entries() <= MOST_FOR_DIFFERENCES {
            moved.store(false, Relaxed);
            let report = case.differences(Some(&planted));
            if moved.load(Relaxed) && report.signal > 1e-3 {
                self.tried_by_differences += 1;
                self.caught_by_differences += usize::from(!report.is_ok());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_wrong_entry_among_two_thousand_is_caught_whichever_it_is() {
        for proof in crate::ops::proofs().iter().filter(|proof| ["atan2", "conv2d", "softmax"].contains(&proof.op)) {
            let case = proof.cases.iter().max_by_key(|case| case.inputs[0].shape().len()).unwrap();
            let expected = Expected::new(case);
            let gradient = case.gradients(&case.inputs, &expected.weights[0], None).1.swap_remove(0);
            let least = 1e-3 * gradient.data().iter().fold(0.0_f64, |a, b| a.max(b.abs()));
            assert!(gradient.data().len() >= 2000, "{}", case.label());
            let rule = case.rules().into_iter().find(|rule| rule.2 == 0).unwrap();
            for i in (0..gradient.data().len()).filter(|&i| gradient.data()[i].abs() > least) {
                let spoil = Box::new(move |_, g: &mut [f64]| g[i] *= 1.0 + 1e-5);
                let planted = Planted { node: rule.0, parent: 0, spoil };
                let spoiled = case.gradients(&case.inputs, &expected.weights[0], Some(planted)).1;
                assert!(expected.error(0, &spoiled) > TOLERANCE, "entry {i} of {}", case.label());
            }
        }
    }

    #[test]
    fn faults_do_what_they_say() {
        let shape = Shape::new(1, 1, 2, 3);
        let spoiled = |fault: Fault, g: [f64; 6]| {
            let mut g = g;
            let moved = fault.spoil(shape, &mut g);
            (moved, g)
        };
        let g = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
        assert_eq!(spoiled(Fault::Sign, g), (true, [-1.0, -2.0, -3.0, -4.0, -5.0, -6.0]));
        assert_eq!(spoiled(Fault::Swap, g), (true, [1.0, 2.0, 3.0, 5.0, 4.0, 6.0]));
        assert_eq!(spoiled(Fault::Border, g), (true, [1.0, 2.0, 0.0, 0.0, 0.0, 0.0]));
        assert_eq!(spoiled(Fault::Entry, g), (true, [1.0, 2.0, 3.0, 4.0 * (1.0 + 1e-5), 5.0, 6.0]));
        assert!(!spoiled(Fault::Swap, [2.0; 6]).0 && !spoiled(Fault::Factor, [0.0; 6]).0);
    }
}
