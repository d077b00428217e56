//! Standard output: results only. A closed pipe comes back as an error that ends the process quietly.

use std::io::{self, Write};

use serde::Serialize;

/// Prints text, with a line end if it has none.
pub fn text(text: &str) -> io::Result<()> {
    let mut out = io::stdout().lock();
    out.write_all(text.as_bytes())?;
    if !text.ends_with('\n') {
        out.write_all(b"\n")?;
    }
    out.flush()
}

/// Prints one JSON document.
pub fn json(value: &impl Serialize) -> anyhow::Result<()> {
    text(&serde_json::to_string_pretty(value)?)?;
    Ok(())
}
