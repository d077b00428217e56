//! A claim of the paper, and what its check says about the verdict.

use serde::Serialize;

use super::findings::{Agreement, Finding, Kind};
use super::sampling::Draw;
use super::trial::Trial;

/// What is known about a claim.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// An identity.
    Exact,
    /// True under the stated condition.
    Conditional,
    /// True to first order only.
    FirstOrder,
    /// Not true as printed; a correction is given.
    Fails,
    /// A number measured on data; the formula behind it is checked.
    Measured,
}

impl Verdict {
    /// The word in tables.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Exact => "exact",
            Self::Conditional => "conditional",
            Self::FirstOrder => "first order",
            Self::Fails => "fails",
            Self::Measured => "measured",
        }
    }
}

/// One equation or mathematical statement of the paper, or one derived to judge it.
#[derive(Clone, Copy, Debug)]
pub struct Claim {
    /// `L01` to `L64`.
    pub id: &'static str,
    /// Short name.
    pub slug: &'static str,
    /// Place in the paper: an equation's label, a section, or "derived".
    pub place: &'static str,
    /// What is claimed.
    pub statement: &'static str,
    /// What is known.
    pub verdict: Verdict,
    /// When it is true, if not always.
    pub condition: Option<&'static str>,
    /// The formula, in plain text.
    pub formula: &'static str,
    /// Why, in a few lines.
    pub derivation: &'static str,
    /// A case in which the printed form misses, with numbers.
    pub counter_example: Option<&'static str>,
    /// What is true instead.
    pub correction: Option<&'static str>,
    /// Functions that compute it, as paths in this crate (`flow::radial::radial_flow`).
    pub functions: &'static [&'static str],
    /// The differentiable operations and losses of the same, as paths in this crate (`taped::rigid_flow::rigid_flow`).
    pub taped: &'static [&'static str],
    /// Why a way to one of its derivatives is not taken.
    pub missing_way: Option<&'static str>,
    /// Compares.
    pub check: fn(&mut Trial),
}

/// How much a verification does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Settings {
    /// Random cases of each claim that samples.
    pub samples: usize,
    /// Seed of all samples.
    pub seed: u64,
}

impl Default for Settings {
    fn default() -> Self {
        Self { samples: 2000, seed: 1 }
    }
}

/// The result of one claim's check.
#[derive(Clone, Debug, Serialize)]
pub struct Outcome {
    /// `L01` to `L64`.
    pub id: &'static str,
    /// Short name.
    pub slug: &'static str,
    /// Place in the paper.
    pub place: &'static str,
    /// The verdict that was checked.
    pub verdict: Verdict,
    /// Inputs looked at.
    pub samples: usize,
    /// All comparisons.
    pub findings: Vec<Finding>,
    /// Derivatives by several ways.
    pub derivatives: Vec<Agreement>,
    /// True when the verdict stands.
    pub ok: bool,
    /// Why it does not stand.
    pub contradictions: Vec<String>,
}

impl Outcome {
    /// The residual closest to its tolerance.
    #[must_use]
    pub fn worst(&self) -> Option<&Finding> {
        let residuals = self.findings.iter().filter(|f| f.kind == Kind::Residual);
        // A NaN is the worst of all.
        let order = |f: &Finding| if f.strain().is_nan() { f64::INFINITY } else { f.strain() };
        residuals.max_by(|a, b| order(a).total_cmp(&order(b)))
    }

    /// The gap closest to its least size.
    #[must_use]
    pub fn narrowest_gap(&self) -> Option<&Finding> {
        let gaps = self.findings.iter().filter(|f| f.kind == Kind::Gap);
        gaps.min_by(|a, b| (a.worst / a.bound).total_cmp(&(b.worst / b.bound)))
    }
}

impl Claim {
    /// Runs the check.
    #[must_use]
    pub fn verify(&self, settings: &Settings) -> Outcome {
        let mut trial = Trial::new(settings.samples, Draw::new(settings.seed, self.id));
        (self.check)(&mut trial);
        let contradictions = self.contradictions(&trial);
        Outcome {
            id: self.id,
            slug: self.slug,
            place: self.place,
            verdict: self.verdict,
            samples: trial.counted(),
            findings: trial.findings.findings().to_vec(),
            derivatives: trial.findings.agreements().to_vec(),
            ok: contradictions.is_empty(),
            contradictions,
        }
    }

    /// What speaks against the verdict.
    fn contradictions(&self, trial: &Trial) -> Vec<String> {
        let mut all = trial.findings.violations();
        let gaps = || trial.findings.findings().iter().filter(|f| f.kind == Kind::Gap);
        let closed = gaps().filter(|f| !f.ok());
        all.extend(closed.map(|f| format!("{}: the gap is {:.3e}, at least {:.1e} was expected", f.what, f.worst, f.bound)));
        let compared = trial.findings.findings().len() > gaps().count() || !trial.findings.agreements().is_empty();
        if trial.counted() == 0 || !compared {
            all.push("nothing was compared".to_owned());
        }
        let needs_gap = matches!(self.verdict, Verdict::Conditional | Verdict::FirstOrder | Verdict::Fails);
        if needs_gap && gaps().count() == 0 {
            all.push(format!(
                "the verdict is '{}', but no case was tried in which the statement does not hold",
                self.verdict.word()
            ));
        }
        all
    }
}

/// The claim with this id (`L28`, `28`) or short name.
#[must_use]
pub fn find(name: &str) -> Option<&'static Claim> {
    let number = |id: &str| id.strip_prefix(['L', 'l']).unwrap_or(id).parse::<u32>().ok();
    let wanted = number(name);
    super::all().iter().copied().find(|c| c.slug == name || (wanted.is_some() && number(c.id) == wanted))
}

/// Runs the checks of several claims, at the same time where threads are free; the result does not depend on their number.
#[must_use]
pub fn verify(claims: &[&Claim], settings: &Settings) -> Vec<Outcome> {
    dimode_autodiff::par::map_indices(claims.len(), |i| claims[i].verify(settings))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn claim(verdict: Verdict, check: fn(&mut Trial)) -> Claim {
        Claim {
            id: "L00",
            slug: "test",
            place: "none",
            statement: "",
            verdict,
            condition: None,
            formula: "",
            derivation: "",
            counter_example: None,
            correction: None,
            functions: &[],
            taped: &[],
            missing_way: None,
            check,
        }
    }

    fn ok(verdict: Verdict, check: fn(&mut Trial)) -> bool {
        claim(verdict, check).verify(&Settings::default()).ok
    }

    fn holds(trial: &mut Trial) {
        trial.count(1);
        trial.findings.residual("x", 0.0, 1e-12);
    }

    #[test]
    fn an_identity_that_holds_is_ok_and_one_that_does_not_is_not() {
        assert!(ok(Verdict::Exact, holds));
        assert!(!ok(Verdict::Exact, |t| {
            holds(t);
            t.findings.residual("y", 1.0, 1e-12);
        }));
    }

    #[test]
    fn a_refuted_claim_whose_printed_form_suddenly_holds_is_contradicted() {
        assert!(ok(Verdict::Fails, |t| {
            holds(t);
            t.findings.gap("printed", 3.0, 1.0);
        }));
        assert!(!ok(Verdict::Fails, |t| {
            holds(t);
            t.findings.gap("printed", 0.0, 1.0);
        }));
        assert!(!ok(Verdict::Fails, holds), "a refutation without a counter-example");
    }

    #[test]
    fn a_check_that_compares_nothing_is_no_proof() {
        assert!(!ok(Verdict::Exact, |_| {}));
        assert!(!ok(Verdict::Exact, |t| t.count(1)));
        assert!(!ok(Verdict::Exact, |t| t.findings.residual("x", 0.0, 1.0)));
        assert!(!ok(Verdict::Fails, |t| {
            t.count(1);
            t.findings.gap("printed", 3.0, 1.0);
        }));
    }
}
