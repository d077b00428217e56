//! Evaluation on worlds that were not trained on.

use serde::{Deserialize, Serialize};

use super::ConfigError;
use super::error::{positive, require};
use crate::data::synthetic::MAX_FRAMES;
use crate::eval::DepthProtocol;

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
    /// How the depth of a run is scored.
    pub fn protocol(&self) -> DepthProtocol {
        DepthProtocol { min_depth: self.min_depth, max_depth: self.max_depth, ..DepthProtocol::default() }
    }

    /// **Errors** [`ConfigError::Value`] for the first value out of range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        require((1..=10_000).contains(&self.worlds), "eval.worlds", self.worlds, "must be 1 to 10000")?;
        let frames = &format!("must be 3 to {MAX_FRAMES}");
        require((3..=MAX_FRAMES).contains(&self.frames), "eval.frames", self.frames, frames)?;
        positive("eval.min_depth", self.min_depth)?;
        positive("eval.max_depth", self.max_depth)?;
        require(self.max_depth > self.min_depth, "eval.max_depth", self.max_depth, "must be above eval.min_depth")
    }
}
