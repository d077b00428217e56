//! Ctrl-C: the first one asks for an orderly stop, the second one stops at once.

use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context;

/// A flag that becomes true at the first Ctrl-C. `promise` is told then, for instance "finishing this step, then saving".
///
/// **Errors** when the system refuses the handler, or one is installed already.
pub fn stop_flag(promise: &'static str) -> anyhow::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = stop.clone();
    let handler = move || {
        if flag.swap(true, Ordering::SeqCst) {
            std::process::exit(130);
        }
        // Nothing can be done about a closed standard error here.
        let _ = writeln!(std::io::stderr(), "\n{promise} (press Ctrl-C again to stop at once)");
    };
    ctrlc::set_handler(handler).context("Ctrl-C cannot be watched")?;
    Ok(stop)
}
