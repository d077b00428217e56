//! What `dimode verify` found, in words: tables for a terminal, one claim in full, JSON, and a document.

mod document;
mod entry;
mod json;
mod recorded;
mod sources;
mod table;
mod words;

use dimode_geometry::ledger::{Claim, Outcome, Settings, Verdict};

pub use document::document;
pub use recorded::recorded;
pub use sources::{check_file, function_file};

/// A claim with what its check found.
#[derive(Clone, Debug)]
pub struct Judged {
    /// The claim.
    pub claim: Claim,
    /// What was found.
    pub outcome: Outcome,
}

/// A verification of some or all claims.
#[derive(Clone, Debug)]
pub struct Verification {
    /// How much was done.
    pub settings: Settings,
    /// The claims, by number.
    pub judged: Vec<Judged>,
}

impl Verification {
    /// Claims whose verdict is contradicted.
    pub fn contradicted(&self) -> Vec<&Judged> {
        self.judged.iter().filter(|j| !j.outcome.ok).collect()
    }

    /// Inputs looked at, over all claims.
    pub fn samples(&self) -> usize {
        self.judged.iter().map(|j| j.outcome.samples).sum()
    }

    /// Number of claims of each verdict; those that do not occur are left out.
    pub fn verdicts(&self) -> Vec<(Verdict, usize)> {
        let of = |verdict| self.judged.iter().filter(|j| j.claim.verdict == verdict).count();
        let all = [Verdict::Exact, Verdict::Conditional, Verdict::FirstOrder, Verdict::Fails, Verdict::Measured];
        all.into_iter().map(|verdict| (verdict, of(verdict))).filter(|(_, count)| *count > 0).collect()
    }

    /// Tables of claims and of derivatives, contradictions, and one line that sums up.
    pub fn tables(&self) -> String {
        let parts = [table::claims(self), table::derivatives(self), table::contradictions(self), self.conclusion()];
        parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join("\n")
    }

    /// Every claim in full, contradictions, and one line that sums up.
    pub fn entries(&self) -> String {
        let entries = self.judged.iter().map(entry::entry);
        entries
            .chain([table::contradictions(self), self.conclusion()])
            .filter(|part| !part.is_empty())
            .collect::<Vec<_>>()
            .join("\n")
    }

    /// Everything as JSON; the keys are described in `docs/data-formats.md`.
    pub fn to_json(&self) -> serde_json::Value {
        json::json(self)
    }

    /// `64 of 64 verdicts stand (..)`.
    pub fn conclusion(&self) -> String {
        let all = self.judged.len();
        let stand = all - self.contradicted().len();
        let verdicts: Vec<String> = self.verdicts().iter().map(|(v, count)| format!("{count} {}", v.word())).collect();
        let noun = if all == 1 { "verdict stands" } else { "verdicts stand" };
        let Settings { seed, .. } = self.settings;
        format!("{stand} of {all} {noun} ({}; {} samples, seed {seed})", verdicts.join(", "), self.samples())
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use dimode_geometry::ledger::{self, Trial};

    use super::*;

    /// Some claims with few samples.
    pub(crate) fn verification(names: &[&str]) -> Verification {
        let settings = Settings { samples: 40, seed: 1 };
        let judge = |name: &&str| {
            let claim = *ledger::find(name).unwrap();
            Judged { claim, outcome: claim.verify(&settings) }
        };
        Verification { settings, judged: names.iter().map(judge).collect() }
    }

    /// A claim that is not true: pi is 3.
    pub(crate) fn false_claim() -> Claim {
        fn check(trial: &mut Trial) {
            trial.count(1);
            trial.findings.residual("pi - 3, relative", std::f64::consts::PI - 3.0, 1e-9);
        }
        Claim { id: "L99", slug: "pi-is-three", check, ..*ledger::find("L15").unwrap() }
    }

    pub(crate) fn contradicted() -> Verification {
        let mut found = verification(&["L15"]);
        let claim = false_claim();
        found.judged.push(Judged { claim, outcome: claim.verify(&found.settings) });
        found
    }

    #[test]
    fn the_last_line_counts_verdicts() {
        let found = verification(&["L01", "L09", "L15", "L20"]);
        let line = found.conclusion();
        assert!(line.starts_with("4 of 4 verdicts stand (3 exact, 1 fails; ") && line.ends_with("samples, seed 1)"), "{line}");
        assert!(found.tables().trim_end().ends_with(&line));
        assert!(contradicted().conclusion().starts_with("1 of 2 verdicts stand"));
    }

    #[test]
    fn contradictions_say_how_to_see_them_again() {
        let text = contradicted().tables();
        for part in [
            "L99 pi-is-three is contradicted",
            "pi - 3, relative: 1.416e-1, tolerance 1.0e-9",
            "dimode verify --id L99 --samples 40 --seed 1",
        ] {
            assert!(text.contains(part), "'{part}' is not in {text}");
        }
        assert!(!verification(&["L15"]).tables().contains("contradicted"));
    }
}
