//! Faults planted in every backward rule, and whether the gradient checks notice.
//!
//! `cargo run --release -p dimode-autodiff --example mutation_table`; exit code 1 when a fault is missed.
//!
//! A cell tells in how many cases the forward-mode oracle caught the fault out of those where the fault makes a difference, and
//! after the plus sign the same of central differences on small cases. `same` marks a fault that makes no difference in any
//! case, as an exchange of entries that are always equal.

use std::process::ExitCode;

use dimode_autodiff::proof::{Fault, Mutation, all, mutations};

fn main() -> ExitCode {
    println!("Factor and entry: 1 + 1e-5, on all entries or on one. Swap: two neighbours. Border: last row and column set to 0.");
    println!();
    println!("| op | rule | {} |", Fault::ALL.map(|fault| fault.to_string()).join(" | "));
    println!("|---|---|{}", "---|".repeat(Fault::ALL.len()));
    let (mut planted, mut missed) = (0, 0);
    for proof in all() {
        for row in mutations(&proof).chunks(Fault::ALL.len()) {
            let cells: Vec<String> = row.iter().map(cell).collect();
            println!("| {} | {}[{}] | {} |", proof.op(), row[0].rule.0, row[0].rule.1, cells.join(" | "));
            planted += row.iter().filter(|m| !m.is_void()).count();
            missed += row.iter().filter(|m| m.is_missed()).count();
        }
    }
    println!();
    println!("Faults in rules: {planted}, missed: {missed}");
    if missed == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

fn cell(m: &Mutation) -> String {
    if m.is_void() {
        return "same".to_string();
    }
    let verdict = if m.is_missed() { "MISSED" } else { "caught" };
    format!("{verdict} {}/{} + {}/{}", m.caught, m.planted, m.caught_by_differences, m.tried_by_differences)
}
