//! `docs/verification.md`: the ledger as a document. It holds nothing that was measured, so every machine makes the same text.

use std::fmt::Write;

use dimode_geometry::ledger::{Agreement, Claim, EQUATIONS};

use super::words::{brief, shortened};
use super::{Judged, Verification, check_file, function_file, table};

const INTRODUCTION: &str = "\
# Verification

<!-- Made by `dimode verify --markdown`; write into the claims (geometry/src/ledger/claims/), not here. -->

Every equation and every mathematical claim of the paper's method sections, with a verdict that a check must uphold:

```sh
cargo run --release -- verify                   # all claims: worst residual against tolerance; exit code 1 if a verdict falls
cargo run --release -- verify --id L28          # one claim in full
cargo run --release -- verify --json            # everything, for programs
cargo run --release -- verify --plots pictures  # flow fields, decompositions, loss landscapes
```

- **exact**: an identity. **conditional**: true under the stated condition. **first order**: true up to terms of second order.
  **fails**: not true as printed; a counter-example and what is true instead are given. **measured**: a number of real data, whose formula is
  checked.
- A check draws cameras, pixels, depths and motions from a seed, takes every fourth case to a limit (no rotation, no radial
  translation, a pixel at the principal point), and compares. *At most*: residuals that must vanish up to rounding. *Documented*: a
  deviation from a written number, divided by the precision that number is known to, so at most 1. *Bound*: an inequality that the
  statement itself makes, which samples may come close to. *All above*: no sample may fall below. *At least*: how far a statement must be
  from true where it does not hold; one counter-example is enough.
  Should a printed form hold after all, its verdict falls.
- Derivatives are found in up to four ways: closed form, forward mode (a second implementation that shares no code with the
  first), the tape that training uses, and central differences. The first three agree to 1e-9 of the scale of the derivative, the last
  to 1e-6.
- Notation: `P_s = R P_t + t` carries target points to the source camera, `t' = R^T t` is the translation in the target's frame, `d = p - p0`
  with `r = |d|`, `f o t = (f_u t_x, f_v t_y)`, `z` is the target depth, `[w]_x` the matrix of a cross product.

This file is made from the ledger (`dimode verify --markdown`), and a test compares it with what the ledger says now.
";

/// The document for a verification with default settings.
pub fn document(found: &Verification) -> String {
    let mut text = INTRODUCTION.to_owned();
    text += &index(found);
    text += &equations(found);
    text += "\n## The claims\n";
    for judged in &found.judged {
        text += &section(judged);
    }
    text
}

fn index(found: &Verification) -> String {
    let verdicts: Vec<String> = found.verdicts().iter().map(|(v, count)| format!("{count} {}", v.word())).collect();
    let mut text = format!("\n## Index\n\n{} claims: {}.\n\n", found.judged.len(), verdicts.join(", "));
    text += "| | place | claim | verdict |\n|---|---|---|---|\n";
    for Judged { claim, .. } in &found.judged {
        let statement = plain(&shortened(claim.statement, 150));
        let _ = writeln!(text, "| {} | {} | {statement} | {} |", link(claim), plain(claim.place), claim.verdict.word());
    }
    text
}

/// Where the equations of the paper are in the code: one row an equation.
fn equations(found: &Verification) -> String {
    let mut text =
        "\n## Where is which equation\n\nLabels are those of the paper's source; in brackets: equations without label. Paths \
                    begin in the crate `dimode_geometry`. The file of a claim holds its check and its property tests.\n\n"
            .to_owned();
    text +=
        "| equation | gives | closed form | on the tape | claims and verdicts | check and tests |\n|---|---|---|---|---|---|\n";
    for equation in EQUATIONS {
        let links = |paths: &[&str]| paths.iter().map(|path| function_link(path)).collect::<Vec<_>>().join("<br>");
        let judged: Vec<&Claim> = equation.claims.iter().filter_map(|id| claim_of(found, id)).collect();
        let Some(chief) = judged.first() else { continue };
        let verdicts: Vec<String> = judged.iter().map(|claim| format!("{} {}", link(claim), claim.verdict.word())).collect();
        let (check, on_tape) = (check_file(chief), links(equation.taped));
        let name = check.rsplit('/').next().unwrap_or_default();
        let _ = writeln!(
            text,
            "| `{}` | {} | {} | {} | {} | [{name}](../{check}) |",
            equation.label,
            plain(equation.gives),
            links(equation.functions),
            if on_tape.is_empty() { "-" } else { &on_tape },
            verdicts.join("<br>"),
        );
    }
    text
}

fn claim_of<'a>(found: &'a Verification, id: &str) -> Option<&'a Claim> {
    found.judged.iter().map(|judged| &judged.claim).find(|claim| claim.id == id)
}

fn link(claim: &Claim) -> String {
    // Anchors are lower case.
    format!("[{}](#{}-{})", claim.id, claim.id.to_lowercase(), claim.slug.to_lowercase())
}

fn function_link(path: &str) -> String {
    format!("[`{path}`](../{})", function_file(path))
}

fn section(judged: &Judged) -> String {
    let claim = &judged.claim;
    let mut text = format!("\n### {} {}\n\n", claim.id, claim.slug);
    let _ = writeln!(text, "*{}.* {}\n", plain(claim.place), plain(claim.statement));
    let condition = claim.condition.map_or_else(String::new, |c| format!(" Condition: {}", plain(c)));
    let _ = writeln!(text, "**{}.**{condition}\n\n```text\n{}\n```", capital(claim.verdict.word()), claim.formula);
    let parts = [("Why", Some(claim.derivation)), ("Counter-example", claim.counter_example), ("Correction", claim.correction)];
    for (name, content) in parts {
        if let Some(content) = content.filter(|content| !content.is_empty()) {
            let _ = writeln!(text, "\n{name}: {}", plain(content));
        }
    }
    let functions: Vec<String> = claim.functions.iter().map(|f| function_link(f)).collect();
    let check = check_file(claim);
    let _ = writeln!(text, "\nFunctions: {}. Check and property tests: [{check}](../{check}).", functions.join(", "));
    if !claim.taped.is_empty() {
        let taped: Vec<String> = claim.taped.iter().map(|f| function_link(f)).collect();
        let _ = writeln!(text, "\nOn the tape: {}.", taped.join(", "));
    }
    if let Some(reason) = claim.missing_way {
        let _ = writeln!(text, "\nA way that is not taken: {}", plain(reason));
    }
    text + &compared(judged)
}

/// What is compared with which bounds, without what was found.
fn compared(judged: &Judged) -> String {
    let mut text = "\n| compared | | bound |\n|---|---|---|\n".to_owned();
    for finding in &judged.outcome.findings {
        let _ = writeln!(text, "| {} | {} | {} |", plain(&finding.what), table::asked(finding), brief(Some(finding.bound)));
    }
    for Agreement { what, forward, tape, central, .. } in &judged.outcome.derivatives {
        let ways = [("forward mode", forward), ("tape", tape), ("central differences", central)];
        let taken: Vec<&str> = ways.into_iter().filter(|(_, found)| found.is_some()).map(|(name, _)| name).collect();
        let (same, central) = (brief(Some(Agreement::TOLERANCE)), brief(Some(Agreement::CENTRAL_TOLERANCE)));
        let bound = match (forward.is_some() || tape.is_some(), central_taken(&taken)) {
            (true, true) => format!("{same}, {central}"),
            (true, false) => same,
            _ => central,
        };
        let _ = writeln!(text, "| derivative {}: {} | at most | {bound} |", plain(what), taken.join(", "));
    }
    text
}

fn central_taken(taken: &[&str]) -> bool {
    taken.contains(&"central differences")
}

fn capital(word: &str) -> String {
    let mut letters = word.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

/// Text in which Markdown sees no marks.
fn plain(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        if matches!(c, '\\' | '`' | '*' | '_' | '~' | '[' | ']' | '<' | '>' | '|' | '#') {
            out.push('\\');
        }
        out.push(c);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::super::tests::verification;
    use super::*;

    /// Labels of equations in a place: the word after `eq.` or `eqs.`, and those that a comma ties to it. `_2` behind a comma is
    /// the label before it with that ending.
    fn labels(place: &str) -> Vec<String> {
        let words: Vec<&str> = place.split_whitespace().collect();
        let mut found: Vec<String> = Vec::new();
        // Whether a label may follow, and whether it is the first of its list.
        let (mut listing, mut first) = (false, false);
        for (i, word) in words.iter().enumerate() {
            let bare = word.trim_end_matches(|c: char| !c.is_alphanumeric());
            if ["eq.", "eqs."].contains(&word.to_lowercase().as_str()) {
                (listing, first) = (true, true);
                continue;
            }
            let ends_here = i + 1 == words.len() || word.ends_with([',', ';', '.', ':']);
            if listing && (first || ends_here) {
                let ending = bare.strip_prefix('_').zip(found.last()).map(|(end, before)| format!("{before}_{end}"));
                found.push(ending.unwrap_or_else(|| bare.to_owned()));
            }
            (listing, first) = (listing && word.ends_with(','), false);
        }
        found
    }

    #[test]
    fn every_equation_that_a_claim_names_has_a_row() {
        for label in dimode_geometry::ledger::all().iter().flat_map(|claim| labels(claim.place)) {
            assert!(EQUATIONS.iter().any(|equation| equation.label == label), "{label} is not in ledger/equations.rs");
        }
    }

    #[test]
    fn labels_of_places() {
        assert_eq!(labels("eq. grad_tz"), ["grad_tz"]);
        assert_eq!(labels("text after eq. rotational_flow"), ["rotational_flow"]);
        assert_eq!(
            labels("eqs. radial_correspondence, radial_correspondence_2, radial_flow"),
            ["radial_correspondence", "radial_correspondence_2", "radial_flow"]
        );
        assert_eq!(labels("eqs. lt, lr, second and fourth terms"), ["lt", "lr"]);
        assert_eq!(labels("eq. la with three frames"), ["la"]);
        assert_eq!(labels("eqs. rotational_correspondence, _h"), ["rotational_correspondence", "rotational_correspondence_h"]);
        assert_eq!(labels("fig. practical, eq. residual_rot; eqs. lp, la"), ["residual_rot", "lp", "la"]);
        assert!(labels("Sect. IV, derived").is_empty());
    }

    #[test]
    fn the_document_tells_no_measured_number() {
        let few = document(&verification(&["L09", "L15", "L20"]));
        let mut other = verification(&["L09", "L15", "L20"]);
        for judged in &mut other.judged {
            judged.outcome = judged.claim.verify(&dimode_geometry::ledger::Settings { samples: 80, seed: 7 });
        }
        assert_eq!(few, document(&other));
    }

    #[test]
    fn sections_link_to_their_files() {
        let text = document(&verification(&["L09", "L20"]));
        for part in [
            "| [L09](#l09-rot-flow-inline) | text after eq. rotational\\_flow |",
            "### L20 grad-tz",
            "| `grad_tz` | df/dt\\_z | [`flow::gradients::translational_gradients`](../geometry/src/flow/gradients.rs)",
            "| [L20](#l20-grad-tz) exact | [l20_grad_tz.rs](../geometry/src/ledger/claims/l20_grad_tz.rs) |",
            "Correction: Both expansions need a minus in front.",
            "| derivative df/dt\\_z: forward mode, tape, central differences | at most | 1e-9, 1e-6 |",
            "| at least | 900 |",
        ] {
            assert!(text.contains(part), "'{part}' is not in {text}");
        }
    }

    #[test]
    fn the_document_in_the_tree_is_that_of_the_ledger() {
        let found = crate::run::verify::all(&crate::progress::Silent);
        let file = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/verification.md");
        let there = std::fs::read_to_string(file).unwrap_or_default();
        assert!(
            there == document(&found),
            "docs/verification.md is not what the ledger says; make it again: cargo run --release -- verify --markdown > docs/verification.md"
        );
    }
}
