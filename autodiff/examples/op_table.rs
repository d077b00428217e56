//! Every operation against its oracles: worst relative errors over all cases.
//!
//! `cargo run --release -p dimode-autodiff --example op_table`; exit code 1 when a bound is exceeded.

use std::process::ExitCode;

use dimode_autodiff::proof::{TOLERANCE, all};

fn main() -> ExitCode {
    println!(
        "Worst relative errors in f64 against a plain loop (bound {TOLERANCE:e}) and central differences, and of f32 against f64."
    );
    println!();
    println!(
        "| op | cases | shapes | value | forward mode | <Jv,w> = <v,J'w> | differences | f32 value | f32 gradient | f32 bound |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    let mut failures = Vec::new();
    for proof in all() {
        let report = proof.check();
        let e = report.errors;
        println!(
            "| {} | {} | {} | {:.1e} | {:.1e} | {:.1e} | {:.1e} | {:.1e} | {:.1e} | {:.0e} |",
            report.op,
            report.cases,
            report.shapes,
            e.value,
            e.tangent,
            e.product,
            e.differences,
            e.single_value,
            e.single_gradient,
            report.single_bound
        );
        if !report.is_ok() {
            failures.push(report);
        }
    }
    println!();
    println!("Operations outside a bound: {}", failures.len());
    failures.iter().for_each(|report| print!("{report}"));
    if failures.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
