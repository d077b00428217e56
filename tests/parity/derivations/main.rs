//! Every reference number of the paper's equations, reproduced by the functions of the geometry crate.

mod alignment;
mod direction;
mod entry;
mod motion;
mod ratios;

use std::collections::BTreeSet;

use entry::{Entry, entries};

/// How to reproduce one entry: its short name, its case, and the comparison.
type Row = (&'static str, &'static str, fn(&Entry));

fn reproduce(rows: &[Row]) {
    let entries = entries();
    for &(id, case, compare) in rows {
        let entry = entries.iter().find(|e| e.name() == (id, case)).unwrap_or_else(|| panic!("no entry {id} {case}"));
        compare(entry);
        entry.finish();
    }
}

#[test]
fn numbers_of_the_motion_components() {
    reproduce(motion::ROWS);
}

#[test]
fn numbers_of_the_alignment() {
    reproduce(alignment::ROWS);
}

#[test]
fn numbers_of_the_direction_losses() {
    reproduce(direction::ROWS);
}

#[test]
fn numbers_of_the_ratio_losses() {
    reproduce(ratios::ROWS);
}

#[test]
fn no_entry_is_left_out() {
    let all = [motion::ROWS, alignment::ROWS, direction::ROWS, ratios::ROWS].concat();
    let reproduced: BTreeSet<_> = all.iter().map(|&(id, case, _)| (id.to_owned(), case.to_owned())).collect();
    assert_eq!(reproduced.len(), all.len(), "an entry is listed twice");
    let stored: BTreeSet<_> = entries().iter().map(|e| (e.name().0.to_owned(), e.name().1.to_owned())).collect();
    let missing: Vec<_> = stored.difference(&reproduced).collect();
    assert!(missing.is_empty(), "{missing:?}");
}
