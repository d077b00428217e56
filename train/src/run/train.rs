//! Training from the first step to the report.

use std::sync::atomic::AtomicBool;

use anyhow::{Result, bail};

use super::{TrainOutcome, TrainRequest};
use crate::progress::Progress;

/// Trains as requested.
///
/// **Errors** always, until the trainer is connected.
pub fn train(request: &TrainRequest, _progress: &dyn Progress, _stop: &AtomicBool) -> Result<TrainOutcome> {
    bail!("{}: training is not connected yet", request.out.display())
}
