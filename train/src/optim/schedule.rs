//! Learning rate over the steps of a run: linear warm-up, then constant or cosine decay.

/// Shape of the learning rate after the warm-up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Decay {
    /// No decay.
    Constant,
    /// Half a cosine down to this fraction of the peak.
    Cosine {
        /// Fraction of the peak at the last step.
        final_fraction: f64,
    },
}

/// Learning rate of step `step` (from 0) of `steps`.
pub fn learning_rate(peak: f64, step: usize, steps: usize, warmup: usize, decay: Decay) -> f64 {
    if step < warmup {
        return peak * (step + 1) as f64 / warmup as f64;
    }
    match decay {
        Decay::Constant => peak,
        Decay::Cosine { final_fraction } => {
            let progress = (step - warmup) as f64 / (steps.saturating_sub(warmup + 1)).max(1) as f64;
            let half = 0.5 * (1.0 + (std::f64::consts::PI * progress.min(1.0)).cos());
            peak * (final_fraction + (1.0 - final_fraction) * half)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn warms_up_and_ends_at_the_fraction() {
        let decay = Decay::Cosine { final_fraction: 0.1 };
        assert_eq!(learning_rate(2.0, 0, 100, 10, decay), 0.2);
        assert_eq!(learning_rate(2.0, 10, 100, 10, decay), 2.0);
        assert!((learning_rate(2.0, 99, 100, 10, decay) - 0.2).abs() < 1e-12);
        assert_eq!(learning_rate(2.0, 50, 100, 10, Decay::Constant), 2.0);
    }
}
