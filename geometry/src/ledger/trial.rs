//! One run of a check.

use super::findings::Findings;
use super::sampling::{Case, Draw};

/// What a check draws from and writes to.
#[derive(Debug)]
pub struct Trial {
    /// Number of samples asked for; checks over whole scenes take as many pixels instead.
    pub samples: usize,
    /// Random numbers of this claim.
    pub draw: Draw,
    /// What was found.
    pub findings: Findings,
    counted: usize,
}

impl Trial {
    /// An empty trial.
    #[must_use]
    pub fn new(samples: usize, draw: Draw) -> Self {
        Self { samples, draw, findings: Findings::default(), counted: 0 }
    }

    /// Runs `at` on as many default cases as were asked for; every fourth is taken to a limit.
    pub fn cases(&mut self, mut at: impl FnMut(&Case, &mut Findings)) {
        for i in 0..self.samples {
            let case = self.draw.case();
            let case = if i % 4 == 3 { case.limit(i / 4) } else { case };
            at(&case, &mut self.findings);
        }
        self.counted += self.samples;
    }

    /// Counts inputs that do not come from [`Trial::cases`]: pixels of a scene, rows of a table.
    pub fn count(&mut self, samples: usize) {
        self.counted += samples;
    }

    /// Inputs looked at so far.
    #[must_use]
    pub fn counted(&self) -> usize {
        self.counted
    }
}
