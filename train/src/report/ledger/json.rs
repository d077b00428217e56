//! Everything that was found, for programs.

use dimode_geometry::ledger::{Agreement, Claim, Finding, Kind, Settings, Verdict};
use serde::Serialize;
use serde_json::Value;

use super::{Judged, Verification, check_file, function_file};

#[derive(Serialize)]
struct Document<'a> {
    settings: Settings,
    summary: Summary,
    claims: Vec<Entry<'a>>,
}

#[derive(Serialize)]
struct Summary {
    ok: bool,
    claims: usize,
    stand: usize,
    contradicted: Vec<&'static str>,
    verdicts: std::collections::BTreeMap<String, usize>,
    samples: usize,
}

#[derive(Serialize)]
struct Entry<'a> {
    id: &'static str,
    slug: &'static str,
    place: &'static str,
    statement: &'static str,
    verdict: Verdict,
    condition: Option<&'static str>,
    formula: &'static str,
    derivation: &'static str,
    counter_example: Option<&'static str>,
    correction: Option<&'static str>,
    functions: Vec<Function>,
    taped: Vec<Function>,
    missing_way: Option<&'static str>,
    check: String,
    samples: usize,
    findings: Vec<Compared<'a>>,
    derivatives: Vec<Derivative<'a>>,
    ok: bool,
    contradictions: &'a [String],
}

#[derive(Serialize)]
struct Function {
    path: &'static str,
    file: String,
}

#[derive(Serialize)]
struct Compared<'a> {
    what: &'a str,
    kind: Kind,
    worst: f64,
    bound: f64,
    count: usize,
    ok: bool,
}

#[derive(Serialize)]
struct Derivative<'a> {
    what: &'a str,
    forward: Option<f64>,
    tape: Option<f64>,
    central: Option<f64>,
    tolerance: f64,
    central_tolerance: f64,
    count: usize,
    ok: bool,
}

fn compared(found: &Finding) -> Compared<'_> {
    let &Finding { ref what, kind, worst, bound, count } = found;
    Compared { what, kind, worst, bound, count, ok: found.ok() }
}

fn derivative(found: &Agreement) -> Derivative<'_> {
    let &Agreement { ref what, forward, tape, central, count } = found;
    let (tolerance, central_tolerance) = (Agreement::TOLERANCE, Agreement::CENTRAL_TOLERANCE);
    Derivative { what, forward, tape, central, tolerance, central_tolerance, count, ok: found.ok() }
}

fn functions(paths: &[&'static str]) -> Vec<Function> {
    paths.iter().map(|path| Function { path, file: function_file(path) }).collect()
}

fn entry(Judged { claim, outcome }: &Judged) -> Entry<'_> {
    let &Claim { id, slug, place, statement, verdict, condition, formula, derivation, .. } = claim;
    Entry {
        id,
        slug,
        place,
        statement,
        verdict,
        condition,
        formula,
        derivation,
        counter_example: claim.counter_example,
        correction: claim.correction,
        functions: functions(claim.functions),
        taped: functions(claim.taped),
        missing_way: claim.missing_way,
        check: check_file(claim),
        samples: outcome.samples,
        findings: outcome.findings.iter().map(compared).collect(),
        derivatives: outcome.derivatives.iter().map(derivative).collect(),
        ok: outcome.ok,
        contradictions: &outcome.contradictions,
    }
}

pub fn json(found: &Verification) -> Value {
    let contradicted: Vec<&'static str> = found.contradicted().iter().map(|j| j.claim.id).collect();
    let summary = Summary {
        ok: contradicted.is_empty(),
        claims: found.judged.len(),
        stand: found.judged.len() - contradicted.len(),
        contradicted,
        verdicts: found.verdicts().into_iter().map(|(verdict, count)| (verdict.word().replace(' ', "-"), count)).collect(),
        samples: found.samples(),
    };
    let document = Document { settings: found.settings, summary, claims: found.judged.iter().map(entry).collect() };
    serde_json::to_value(document).expect("strings, numbers and lists have a JSON form")
}

#[cfg(test)]
mod tests {
    use super::super::tests::{contradicted, verification};
    use super::*;

    fn keys(value: &Value) -> Vec<&str> {
        value.as_object().unwrap().keys().map(String::as_str).collect()
    }

    #[test]
    fn keys_are_those_of_the_documentation() {
        let docs = include_str!("../../../../docs/data-formats.md");
        let section = docs.split("## What `verify --json` prints").nth(1).expect("a section on verify");
        let found = verification(&["L20"]).to_json();
        let claim = &found["claims"][0];
        let levels = [
            &found,
            &found["settings"],
            &found["summary"],
            claim,
            &claim["functions"][0],
            &claim["findings"][0],
            &claim["derivatives"][0],
        ];
        for key in levels.into_iter().flat_map(keys) {
            assert!(section.contains(&format!("`{key}`")), "'{key}' is not documented");
        }
    }

    #[test]
    fn what_was_found_is_told() {
        let found = contradicted().to_json();
        assert_eq!((found["summary"]["ok"].as_bool(), found["summary"]["stand"].as_u64()), (Some(false), Some(1)));
        assert_eq!(found["summary"]["contradicted"][0], "L99");
        assert_eq!(found["summary"]["verdicts"]["exact"], 2);
        let finding = &found["claims"][1]["findings"][0];
        assert_eq!((finding["kind"].as_str(), finding["ok"].as_bool()), (Some("residual"), Some(false)));
        assert!((finding["worst"].as_f64().unwrap() - 0.14159265).abs() < 1e-8);
        assert!(found["claims"][1]["contradictions"][0].as_str().unwrap().contains("tolerance 1.0e-9"));
        assert_eq!(found["claims"][0]["functions"][0]["file"], "geometry/src/flow/radial.rs");
    }
}
