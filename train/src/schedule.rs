//! Which stage a step belongs to: the stages are data, the loop knows no numbers.

use crate::config::{StageConfig, TrainConfig};

/// The stages of a run with the step at which each ends.
#[derive(Clone, Debug, PartialEq)]
pub struct Schedule {
    stages: Vec<(StageConfig, u64)>,
}

impl Schedule {
    /// Divides the steps by the stages' shares; with `only_stages` the steps of the others go to the last one named.
    ///
    /// # Panics
    /// When no stage is left (a validated configuration has one).
    pub fn new(config: &TrainConfig) -> Self {
        let chosen: Vec<usize> = match &config.only_stages {
            Some(numbers) => numbers.iter().map(|n| n - 1).collect(),
            None => (0..config.stages.len()).collect(),
        };
        let total: f64 = config.stages.iter().map(|s| s.share).sum();
        let mut at = 0.0;
        let mut stages: Vec<_> = chosen
            .iter()
            .map(|&i| {
                at += config.stages[i].share / total;
                (config.stages[i].clone(), (at * config.steps as f64).round() as u64)
            })
            .collect();
        stages.last_mut().expect("at least one stage").1 = config.steps;
        Schedule { stages }
    }

    /// The stage of a step: its index in this run and its settings.
    pub fn stage(&self, step: u64) -> (usize, &StageConfig) {
        let index = self.stages.iter().position(|s| step < s.1).unwrap_or(self.stages.len() - 1);
        (index, &self.stages[index].0)
    }

    /// Name of each stage and the step at which it ends.
    pub fn ends(&self) -> impl Iterator<Item = (&str, u64)> {
        self.stages.iter().map(|(stage, end)| (stage.name.as_str(), *end))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_papers_stages_take_their_shares() {
        let config = TrainConfig { steps: 300, stages: StageConfig::paper(), ..TrainConfig::default() };
        let schedule = Schedule::new(&config);
        assert_eq!(schedule.ends().map(|e| e.1).collect::<Vec<_>>(), [50, 150, 300]);
        assert_eq!(schedule.stage(49).0, 0);
        assert_eq!(schedule.stage(50).0, 1);
        assert_eq!(schedule.stage(299).0, 2);
        assert!(schedule.stage(10).1.train_flow && !schedule.stage(60).1.train_flow);
    }

    #[test]
    fn stage_one_alone_keeps_all_steps() {
        let config = TrainConfig { steps: 300, only_stages: Some(vec![1]), ..TrainConfig::default() };
        let schedule = Schedule::new(&config);
        assert_eq!(schedule.ends().map(|e| e.1).collect::<Vec<_>>(), [300]);
        assert_eq!(schedule.stage(299).1.lambda1, 0.0);
    }
}
