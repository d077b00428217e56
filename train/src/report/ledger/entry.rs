//! One claim in full.

use super::words::wrapped;
use super::{Judged, check_file, function_file, table};

/// Width of the text beside the names of the parts.
const WIDTH: usize = 100;
/// Width of the names of the parts.
const NAMES: usize = 17;

/// Place, statement, verdict, reasons, functions and everything that was compared.
pub fn entry(judged: &Judged) -> String {
    let (claim, outcome) = (&judged.claim, &judged.outcome);
    let mut text = format!("{} {}\n", claim.id, claim.slug);
    let parts = [
        ("place", Some(claim.place)),
        ("statement", Some(claim.statement)),
        ("verdict", Some(claim.verdict.word())),
        ("condition", claim.condition),
        ("formula", Some(claim.formula)),
        ("derivation", Some(claim.derivation)),
        ("counter-example", claim.counter_example),
        ("correction", claim.correction),
    ];
    for (name, content) in parts {
        if let Some(content) = content.filter(|content| !content.is_empty()) {
            text += &part(name, &wrapped(content, WIDTH));
        }
    }
    let located = |paths: &[&str]| paths.iter().map(|f| format!("{f} ({})", function_file(f))).collect::<Vec<_>>();
    text += &part("functions", &located(claim.functions));
    text += &part("on the tape", &located(claim.taped));
    text += &part("missing way", &wrapped(claim.missing_way.unwrap_or_default(), WIDTH));
    text += &part("check", &[check_file(claim)]);
    text += &part("samples", &[outcome.samples.to_string()]);
    text + &table::findings(judged)
}

/// A name and the lines that belong to it, one below the other.
fn part(name: &str, lines: &[String]) -> String {
    let line = |(i, line): (usize, &String)| format!("  {:NAMES$}{line}\n", if i == 0 { name } else { "" });
    lines.iter().enumerate().map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::super::tests::verification;

    #[test]
    fn an_entry_holds_all_parts() {
        let text = verification(&["L09"]).entries();
        for word in [
            "L09 rot-flow-inline",
            "place            text after eq. rotational_flow",
            "verdict          fails",
            "counter-example",
            "Both expansions need a minus in front.",
            "flow::rotational::quadratic_terms (geometry/src/flow/rotational.rs)",
            "geometry/src/ledger/claims/l09_rot_flow_inline.rs",
            "flow with the printed signs - flow, px",
            "at least",
            "1 of 1 verdict stands",
        ] {
            assert!(text.contains(word), "'{word}' is not in {text}");
        }
        assert!(verification(&["L20"]).entries().contains("df/dt_z"));
    }
}
