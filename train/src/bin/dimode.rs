//! The `dimode` command.

use std::process::ExitCode;

fn main() -> ExitCode {
    dimode::cli::main()
}
