//! What a check found: residuals that must vanish and gaps that must not.

use serde::Serialize;

/// What is asked of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// The largest must be at most the bound.
    Residual,
    /// A deviation from a number written down, in units of the precision it is known to: the largest must be at most 1.
    Documented,
    /// The largest must be at least the bound: one counter-example is enough.
    Gap,
    /// An inequality that the statement itself makes: the largest must be at most the bound, and may come close to it.
    Bound,
    /// The smallest must be at least the bound: no sample may fall below.
    Floor,
}

/// The worst of one kind of comparison over all samples.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// What was compared, with its unit.
    pub what: String,
    /// What is asked.
    pub kind: Kind,
    /// Largest value met; NaN when one was.
    pub worst: f64,
    /// Tolerance of a residual, least size of a gap.
    pub bound: f64,
    /// Number of comparisons.
    pub count: usize,
}

impl Finding {
    /// True when the bound is kept. NaN keeps none.
    #[must_use]
    pub fn ok(&self) -> bool {
        match self.kind {
            Kind::Residual | Kind::Documented | Kind::Bound => self.worst <= self.bound,
            Kind::Gap | Kind::Floor => self.worst >= self.bound,
        }
    }

    /// How close a residual comes to its tolerance: 1 is the limit.
    #[must_use]
    pub fn strain(&self) -> f64 {
        match self.worst {
            0.0 => 0.0,
            worst => worst / self.bound,
        }
    }
}

/// Agreement of the ways to one derivative, each relative to the scale of that derivative.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Agreement {
    /// Which derivative.
    pub what: String,
    /// Closed form against forward mode, worst.
    pub forward: Option<f64>,
    /// Closed form (where there is none: forward mode) against the tape, worst.
    pub tape: Option<f64>,
    /// The same against central differences, worst.
    pub central: Option<f64>,
    /// Number of comparisons.
    pub count: usize,
}

impl Agreement {
    /// Largest relative error allowed against forward mode and against the tape.
    pub const TOLERANCE: f64 = 1e-9;
    /// Largest relative error allowed against central differences.
    pub const CENTRAL_TOLERANCE: f64 = 1e-6;

    /// True when every way that was taken agrees, and at least two were compared.
    #[must_use]
    pub fn ok(&self) -> bool {
        let kept = |worst: Option<f64>, bound| worst.is_none_or(|w| w <= bound);
        let any = [self.forward, self.tape, self.central].iter().any(Option::is_some);
        any && kept(self.forward, Self::TOLERANCE)
            && kept(self.tape, Self::TOLERANCE)
            && kept(self.central, Self::CENTRAL_TOLERANCE)
    }
}

/// Collects what a check finds; keeps the worst of each kind, in the order of first mention.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Findings {
    findings: Vec<Finding>,
    agreements: Vec<Agreement>,
}

/// The larger of two, NaN when one is NaN.
fn worse(a: f64, b: f64) -> f64 {
    if a.is_nan() || a > b { a } else { b }
}

impl Findings {
    /// All comparisons, in the order of first mention.
    #[must_use]
    pub fn findings(&self) -> &[Finding] {
        &self.findings
    }

    /// All derivatives, in the order of first mention.
    #[must_use]
    pub fn agreements(&self) -> &[Agreement] {
        &self.agreements
    }

    fn add(&mut self, kind: Kind, what: &str, value: f64, bound: f64) {
        match self.findings.iter_mut().find(|f| f.what == what && f.kind == kind) {
            Some(found) => {
                assert!(found.bound == bound, "one bound for '{what}': {} and {bound}", found.bound);
                found.worst = if kind == Kind::Floor { -worse(-value, -found.worst) } else { worse(value, found.worst) };
                found.count += 1;
            }
            None => self.findings.push(Finding { what: what.to_owned(), kind, worst: value, bound, count: 1 }),
        }
    }

    /// A number that is zero but for rounding (or for what the statement allows): at most `tolerance`. Signs do not count.
    ///
    /// `what` names the comparison and its unit; calls of one name keep the worst, with one tolerance.
    pub fn residual(&mut self, what: &str, value: f64, tolerance: f64) {
        self.add(Kind::Residual, what, value.abs(), tolerance);
    }

    /// `a = b` relative to `scale`.
    pub fn equal(&mut self, what: &str, a: f64, b: f64, scale: f64, tolerance: f64) {
        // Equal infinities are no agreement: their difference is NaN, which no bound accepts.
        self.residual(what, if a == b && a.is_finite() { 0.0 } else { (a - b) / scale }, tolerance);
    }

    /// A number written down somewhere: `|a - b| <= relative |b|`, counted in units of that precision.
    ///
    /// A written 0 allows 1e-9. For another absolute precision see [`Findings::documented_within`].
    pub fn documented(&mut self, what: &str, a: f64, b: f64, relative: f64) {
        self.documented_within(what, a, b, if b == 0.0 { 1e-9 } else { relative * b.abs() });
    }

    /// A number written down with an absolute precision: `|a - b| <= precision`, counted in units of it.
    pub fn documented_within(&mut self, what: &str, a: f64, b: f64, precision: f64) {
        self.add(Kind::Documented, what, ((a - b) / precision).abs(), 1.0);
    }

    /// An inequality of the statement: `value <= at_most` in every sample, by right and not by rounding. The sign counts.
    pub fn bound(&mut self, what: &str, value: f64, at_most: f64) {
        self.add(Kind::Bound, what, value, at_most);
    }

    /// `value >= at_least` in every sample.
    pub fn floor(&mut self, what: &str, value: f64, at_least: f64) {
        self.add(Kind::Floor, what, value, at_least);
    }

    /// How far a statement is from true: the largest over all samples must reach `at_least`.
    pub fn gap(&mut self, what: &str, value: f64, at_least: f64) {
        self.add(Kind::Gap, what, value.abs(), at_least);
    }

    /// One derivative, entry by entry, by several ways; `scale` is the size that rounding errors are measured against.
    ///
    /// `reference` is the closed form (or forward mode where there is none, then `forward` is `None`).
    pub fn derivative(
        &mut self,
        what: &str,
        reference: &[f64],
        forward: Option<&[f64]>,
        tape: Option<&[f64]>,
        central: Option<&[f64]>,
        scale: f64,
    ) {
        let gap = |other: Option<&[f64]>| {
            other.map(|other| {
                assert_eq!(other.len(), reference.len(), "'{what}': derivatives of equal length");
                let errors = reference.iter().zip(other).map(|(a, b)| (a - b).abs() / scale);
                errors.fold(0.0, |worst, e| worse(e, worst))
            })
        };
        let found = [gap(forward), gap(tape), gap(central)];
        let index = match self.agreements.iter().position(|a| a.what == what) {
            Some(index) => index,
            None => {
                let empty = Agreement { what: what.to_owned(), forward: None, tape: None, central: None, count: 0 };
                self.agreements.push(empty);
                self.agreements.len() - 1
            }
        };
        let known = &mut self.agreements[index];
        known.count += 1;
        for (slot, found) in [&mut known.forward, &mut known.tape, &mut known.central].into_iter().zip(found) {
            if let Some(found) = found {
                *slot = Some(slot.map_or(found, |before| worse(found, before)));
            }
        }
    }

    /// What does not hold: residuals above their tolerance and derivatives that disagree. Gaps are judged over all samples by
    /// [`Outcome::ok`](super::Outcome).
    #[must_use]
    pub fn violations(&self) -> Vec<String> {
        let residuals = self.findings.iter().filter(|f| f.kind != Kind::Gap && !f.ok());
        let residuals = residuals.map(|f| format!("{}: {:.3e}, tolerance {:.1e}", f.what, f.worst, f.bound));
        let derivatives = self.agreements.iter().filter(|a| !a.ok());
        let derivatives = derivatives
            .map(|a| format!("derivative {}: forward {:?}, tape {:?}, central {:?}", a.what, a.forward, a.tape, a.central));
        residuals.chain(derivatives).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worst_of_each_name_is_kept() {
        let mut f = Findings::default();
        f.residual("flow, px", -0.5, 1.0);
        f.residual("flow, px", 0.25, 1.0);
        f.gap("sign", 1.0, 2.0);
        f.gap("sign", 3.0, 2.0);
        assert_eq!(f.findings().len(), 2);
        assert_eq!((f.findings()[0].worst, f.findings()[0].count), (0.5, 2));
        assert!(f.findings().iter().all(Finding::ok) && f.violations().is_empty());
    }

    #[test]
    fn documented_numbers_are_counted_in_units_of_their_precision() {
        let mut f = Findings::default();
        f.documented("a number", 2.5001, 2.5, 1e-4);
        let found = &f.findings()[0];
        assert_eq!((found.kind, found.bound, found.ok()), (Kind::Documented, 1.0, true));
        f.documented("a number", 2.5003, 2.5, 1e-4);
        assert!(!f.findings()[0].ok() && f.violations().len() == 1);
    }

    #[test]
    fn a_floor_keeps_the_smallest_and_a_bound_the_largest() {
        let mut f = Findings::default();
        for value in [3.0, 1.0, 2.0] {
            f.floor("long enough", value, 1.5);
            f.bound("short enough", value, 3.0);
        }
        assert_eq!([f.findings()[0].worst, f.findings()[1].worst], [1.0, 3.0]);
        assert_eq!(f.findings().iter().map(Finding::ok).collect::<Vec<_>>(), [false, true]);
        assert_eq!(f.violations().len(), 1);
        f.floor("finite", f64::NAN, 0.0);
        f.floor("finite", 5.0, 0.0);
        assert!(!f.findings()[2].ok());
    }

    #[test]
    fn nothing_accepts_what_is_no_number() {
        let mut f = Findings::default();
        f.residual("a", f64::NAN, 1.0);
        f.residual("a", 0.0, 1.0);
        f.gap("b", 5.0, 1.0);
        f.gap("b", f64::NAN, 1.0);
        f.equal("c", f64::INFINITY, f64::INFINITY, 1.0, 1.0);
        f.derivative("d", &[1.0, 2.0], None, Some(&[1.0, f64::NAN]), None, 1.0);
        f.derivative("d", &[1.0, 2.0], None, Some(&[1.0, 2.0]), None, 1.0);
        assert!(f.findings().iter().all(|x| !x.ok()));
        assert!(!f.agreements()[0].ok());
        assert_eq!(f.violations().len(), 3);
    }

    #[test]
    fn a_derivative_that_is_one_percent_off_is_noticed() {
        let mut f = Findings::default();
        f.derivative("x", &[1.0], Some(&[1.0]), Some(&[1.0]), Some(&[1.01]), 1.0);
        assert!(!f.agreements()[0].ok());
        let mut f = Findings::default();
        f.derivative("x", &[1.0], Some(&[1.0]), Some(&[1.0 + 1e-8]), None, 1.0);
        assert!(!f.agreements()[0].ok());
    }

    #[test]
    fn a_derivative_compared_with_nothing_is_no_proof() {
        let mut f = Findings::default();
        f.derivative("x", &[1.0], None, None, None, 1.0);
        assert!(!f.agreements()[0].ok());
    }

    #[test]
    #[should_panic(expected = "one bound for 'a'")]
    fn a_tolerance_cannot_change_on_the_way() {
        let mut f = Findings::default();
        f.residual("a", 0.0, 1.0);
        f.residual("a", 0.0, 2.0);
    }
}
