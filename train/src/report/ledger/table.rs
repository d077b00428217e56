//! The tables of `dimode verify`.

use comfy_table::{Cell, CellAlignment, Table, presets};
use dimode_geometry::ledger::{Agreement, Finding, Kind, Outcome, Verdict};

use super::words::{brief, wrapped, yes};
use super::{Judged, Verification};

/// Widest place in the paper before it breaks into lines.
const PLACE: usize = 32;
/// Widest name of a comparison before it breaks into lines.
const WHAT: usize = 62;

fn table(heads: &[&str], left: usize) -> Table {
    let mut table = Table::new();
    table.load_style(presets::UTF8_FULL_CONDENSED);
    table.set_header(heads.iter().enumerate().map(|(i, head)| aligned(head, i < left)));
    table
}

fn aligned(text: &str, left: bool) -> Cell {
    Cell::new(text).set_alignment(if left { CellAlignment::Left } else { CellAlignment::Right })
}

fn add(table: &mut Table, left: usize, cells: &[String]) {
    table.add_row(cells.iter().enumerate().map(|(i, cell)| aligned(cell, i < left)));
}

fn lines(text: &str, width: usize) -> String {
    wrapped(text, width).join("\n")
}

/// One row a claim: verdict, the residual closest to its tolerance, the gap closest to its least size.
pub fn claims(found: &Verification) -> String {
    let heads = ["", "place", "verdict", "samples", "residual", "tolerance", "misses by", "at least", "ok"];
    let mut table = table(&heads, 3);
    for Judged { claim, outcome } in &found.judged {
        // An identity has nothing to miss by: its gaps show what it does not say.
        let refutable = !matches!(claim.verdict, Verdict::Exact | Verdict::Measured);
        let (worst, gap) = (worst(outcome), outcome.narrowest_gap().filter(|_| refutable));
        let cells = [
            claim.id.to_owned(),
            lines(claim.place, PLACE),
            claim.verdict.word().to_owned(),
            outcome.samples.to_string(),
            brief(worst.map(|(value, _)| value)),
            brief(worst.map(|(_, bound)| bound)),
            brief(gap.map(|f| f.worst)),
            brief(gap.map(|f| f.bound)),
            yes(outcome.ok).to_owned(),
        ];
        add(&mut table, 3, &cells);
    }
    format!(
        "Claims of the paper\n{}\n  residual: the comparison closest to its tolerance, derivatives included. misses by: how far the statement is from true where\n  it does not hold (as printed, or outside of its condition), the gap closest to the least that is asked. Units: --id ID.\n",
        table.trim_fmt()
    )
}

/// The residual or the error of a derivative that is closest to its tolerance, with the tolerance; a NaN before all. Inequalities
/// and documented numbers count where a claim has nothing else.
fn worst(outcome: &Outcome) -> Option<(f64, f64)> {
    let of = |kind| outcome.findings.iter().filter(move |f| f.kind == kind).map(|f| (f.worst, f.bound));
    let ways = |a: &Agreement| {
        let (same, central) = (Agreement::TOLERANCE, Agreement::CENTRAL_TOLERANCE);
        [(a.forward, same), (a.tape, same), (a.central, central)].map(|(found, bound)| Some((found?, bound)))
    };
    let derivatives = outcome.derivatives.iter().flat_map(ways).flatten();
    let strain = |&(value, bound): &(f64, f64)| if value.is_nan() { f64::INFINITY } else { value / bound };
    let closest = |a: &(f64, f64), b: &(f64, f64)| strain(a).total_cmp(&strain(b));
    let residuals = of(Kind::Residual).chain(derivatives).max_by(closest);
    residuals.or_else(|| of(Kind::Bound).max_by(closest)).or_else(|| of(Kind::Documented).max_by(closest))
}

/// One row a derivative; empty when no claim has one.
pub fn derivatives(found: &Verification) -> String {
    let all = found.judged.iter().flat_map(|j| j.outcome.derivatives.iter().map(|a| (j.claim.id, a)));
    let rows: Vec<(&str, &Agreement)> = all.collect();
    if rows.is_empty() {
        return String::new();
    }
    format!(
        "Derivatives by up to four ways: closed form against the others, relative errors\n{}\n  -: not taken, --id ID tells why. L62 has no closed form: forward mode takes its place.\n",
        agreements(&rows).trim_fmt()
    )
}

fn agreements(rows: &[(&str, &Agreement)]) -> Table {
    let (tolerance, central) = (brief(Some(Agreement::TOLERANCE)), brief(Some(Agreement::CENTRAL_TOLERANCE)));
    let forward = format!("forward mode\n<= {tolerance}");
    let (tape, central) = (format!("tape\n<= {tolerance}"), format!("central differences\n<= {central}"));
    let mut table = table(&["", "derivative", &forward, &tape, &central, "times", "ok"], 2);
    for (id, found) in rows {
        let cells = [
            (*id).to_owned(),
            lines(&found.what, WHAT),
            brief(found.forward),
            brief(found.tape),
            brief(found.central),
            found.count.to_string(),
            yes(found.ok()).to_owned(),
        ];
        add(&mut table, 2, &cells);
    }
    table
}

/// All findings of one claim.
pub fn findings(judged: &Judged) -> String {
    let mut table = table(&["compared", "asked", "found", "bound", "times", "ok"], 2);
    for found in &judged.outcome.findings {
        let cells = [
            lines(&found.what, WHAT),
            asked(found).to_owned(),
            brief(Some(found.worst)),
            brief(Some(found.bound)),
            found.count.to_string(),
            yes(found.ok()).to_owned(),
        ];
        add(&mut table, 2, &cells);
    }
    let rows: Vec<(&str, &Agreement)> = judged.outcome.derivatives.iter().map(|a| (judged.claim.id, a)).collect();
    let mut text = String::new();
    if !judged.outcome.findings.is_empty() {
        text += &format!("{}\n", table.trim_fmt());
    }
    if !rows.is_empty() {
        text += &format!("{}\n", agreements(&rows).trim_fmt());
    }
    text
}

/// What a bound means.
pub fn asked(found: &Finding) -> &'static str {
    match found.kind {
        Kind::Residual => "at most",
        Kind::Documented => "documented",
        Kind::Bound => "bound",
        Kind::Floor => "all above",
        Kind::Gap => "at least",
    }
}

/// What speaks against verdicts, and how to see it again; empty when nothing does.
pub fn contradictions(found: &Verification) -> String {
    let settings = found.settings;
    let told = found.contradicted().into_iter().map(|Judged { claim, outcome }| {
        let reasons: String = outcome.contradictions.iter().map(|reason| format!("  {reason}\n")).collect();
        let again = format!("dimode verify --id {} --samples {} --seed {}", claim.id, settings.samples, settings.seed);
        format!("{} {} is contradicted ('{}'):\n{reasons}  again: {again}\n", claim.id, claim.slug, claim.verdict.word())
    });
    told.collect()
}

#[cfg(test)]
mod tests {
    use super::super::tests::{contradicted, verification};
    use super::*;

    #[test]
    fn every_claim_and_every_derivative_has_a_row() {
        let found = verification(&["L01", "L09", "L15", "L20"]);
        let text = claims(&found);
        for word in ["L01", "eq. intrinsic_matrix", "fails", "900", "yes"] {
            assert!(text.contains(word), "'{word}' is not in {text}");
        }
        assert!(text.lines().all(|line| line.chars().count() <= 140), "{text}");
        let text = derivatives(&found);
        assert!(text.contains("df/dt_z") && text.contains("<= 1e-6"), "{text}");
        assert_eq!(derivatives(&verification(&["L09"])), "");
    }

    #[test]
    fn the_worst_comparison_is_told() {
        let outcome = |name| verification(&[name]).judged[0].outcome.clone();
        let (value, bound) = worst(&outcome("L20")).unwrap();
        assert!(value < bound && [1e-9, 1e-6].contains(&bound), "a derivative, no documented number: {value} {bound}");
        let found = contradicted();
        assert_eq!(worst(&found.judged[1].outcome).map(|(_, bound)| bound), Some(1e-9));
        let mut broken = outcome("L15");
        broken.findings[0].worst = f64::NAN;
        assert!(worst(&broken).unwrap().0.is_nan());
    }

    #[test]
    fn what_does_not_hold_is_seen() {
        assert!(claims(&contradicted()).contains(" NO "));
        assert_eq!(contradictions(&verification(&["L15"])), "");
    }
}
