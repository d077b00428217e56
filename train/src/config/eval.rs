//! Evaluation on worlds that were not trained on.

use serde::{Deserialize, Serialize};

use super::ConfigError;
use super::error::{positive, require};

/// Evaluation after training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EvalConfig {
    /// Held-out worlds.
    pub worlds: usize,
    /// Frames of each held-out world.
    pub frames: usize,
    /// Smallest true depth that is scored, in metres.
    pub min_depth: f64,
    /// Largest true depth that is scored, in metres.
    pub max_depth: f64,
}

impl Default for EvalConfig {
    fn default() -> Self {
        Self { worlds: 12, frames: 16, min_depth: 0.1, max_depth: 80.0 }
    }
}

impl EvalConfig {
    /// **Errors** [`ConfigError::Value`] for the first value out of range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        require((1..=10_000).contains(&self.worlds), "eval.worlds", self.worlds, "must be 1 to 10000")?;
        require((3..=100_000).contains(&self.frames), "eval.frames", self.frames, "must be 3 to 100000")?;
        positive("eval.min_depth", self.min_depth)?;
        positive("eval.max_depth", self.max_depth)?;
        require(self.max_depth > self.min_depth, "eval.max_depth", self.max_depth, "must be above eval.min_depth")
    }
}
