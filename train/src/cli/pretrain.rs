//! What the commands of `dimode pretrain` share: where they may write, how they end.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use serde::Serialize;

use super::failure::{self, Exit, UsageError};
use super::output;

/// Whether files can be written is better known before the training than after it.
pub fn check_out(out: &Path, force: bool) -> anyhow::Result<()> {
    if out.exists() && !force {
        let what = format!("{}: already there", out.display());
        return Err(UsageError::new(what, "name another one, or add --force to replace it").into());
    }
    let folder = out.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let probe = folder.join(format!(".dimode-{}.tmp", std::process::id()));
    let written =
        std::fs::create_dir_all(folder).and_then(|()| std::fs::write(&probe, "")).and_then(|()| std::fs::remove_file(&probe));
    Ok(written.map_err(|error| crate::data::DataError::write(out, error))?)
}

/// Prints the errors on held-out worlds, or tells why there are none.
pub fn conclude<E: Serialize>(
    trained: anyhow::Result<Vec<E>>,
    stop: &AtomicBool,
    json: bool,
    out: &Path,
    line: impl Fn(&E) -> String,
) -> anyhow::Result<Exit> {
    match trained {
        Err(error) if stop.load(Ordering::SeqCst) => {
            failure::tell(&error);
            return Ok(Exit::Interrupted);
        }
        Err(error) => return Err(error),
        Ok(errors) if json => output::json(&errors)?,
        Ok(errors) => {
            let lines: String = errors.iter().map(line).collect();
            output::text(&format!("{lines}wrote {}", out.display()))?;
        }
    }
    Ok(Exit::Done)
}
