//! Frames per second.

use std::time::{Duration, Instant};

use dimode_autodiff::par;
use serde::Serialize;

/// Frames (or pairs of frames) per second over a sequence. The first of each network is not counted: it fills buffers.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Speed {
    /// Threads that worked.
    pub threads: usize,
    /// Width and height that the networks saw.
    pub size: [usize; 2],
    /// The depth network alone.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depth: Option<f64>,
    /// The pose network alone, with all its looks.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pose: Option<f64>,
    /// The flow network alone.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub flow: Option<f64>,
    /// All networks, one after another.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub networks: Option<f64>,
    /// Everything, reading and writing included, over all frames.
    pub whole: f64,
}

/// Times of one network.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Clock {
    runs: usize,
    /// Of all runs but the first.
    spent: Duration,
}

impl Clock {
    /// Runs and times a network.
    pub fn time<R>(&mut self, run: impl FnOnce() -> R) -> R {
        let begin = Instant::now();
        let result = run();
        if self.runs > 0 {
            self.spent += begin.elapsed();
        }
        self.runs += 1;
        result
    }

    /// Mean seconds of a run; none when there was but the first.
    fn seconds(&self) -> Option<f64> {
        let counted = self.runs.checked_sub(1).filter(|&runs| runs > 0)?;
        Some(self.spent.as_secs_f64() / counted as f64)
    }
}

/// The clocks of a sequence.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Clocks {
    pub depth: Clock,
    pub pose: Clock,
    pub flow: Clock,
}

impl Clocks {
    /// Speeds of a sequence of `frames` that took `whole` in all.
    pub fn speed(&self, (width, height): (usize, usize), frames: usize, whole: Duration) -> Speed {
        let seconds = [self.depth, self.pose, self.flow].map(|clock| clock.seconds());
        let [depth, pose, flow] = seconds.map(|seconds| seconds.map(f64::recip));
        let all: f64 = seconds.into_iter().flatten().sum();
        let networks = (all > 0.0).then(|| 1.0 / all);
        let whole = frames as f64 / whole.as_secs_f64().max(1e-9);
        Speed { threads: par::threads(), size: [width, height], depth, pose, flow, networks, whole }
    }
}

impl Speed {
    /// `networks alone 12.3 frames/s (depth 20.1, pose 31.6), with reading and writing 9.8`.
    pub fn told(&self) -> String {
        let parts = [("depth", self.depth), ("pose", self.pose), ("flow", self.flow)];
        let parts: Vec<String> =
            parts.into_iter().filter_map(|(name, speed)| speed.map(|speed| format!("{name} {speed:.1}"))).collect();
        let alone = match self.networks {
            Some(speed) => format!("networks alone {speed:.1} frames/s ({}), ", parts.join(", ")),
            None => String::new(),
        };
        let [width, height] = self.size;
        format!("{alone}with reading and writing {:.1} frames/s, at {width}x{height}", self.whole)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_run_is_not_counted() {
        let mut clock = Clock::default();
        clock.time(|| std::thread::sleep(Duration::from_millis(200)));
        assert_eq!(clock.seconds(), None);
        for _ in 0..2 {
            clock.time(|| std::thread::sleep(Duration::from_millis(1)));
        }
        let seconds = clock.seconds().unwrap();
        assert!((0.001..0.1).contains(&seconds), "{seconds}");
    }

    #[test]
    fn times_of_networks_add_up() {
        let clock = |milliseconds: u64| Clock { runs: 3, spent: Duration::from_millis(2 * milliseconds) };
        let clocks = Clocks { depth: clock(20), pose: Clock::default(), flow: clock(30) };
        let speed = clocks.speed((640, 192), 4, Duration::from_secs(2));
        let near = |a: Option<f64>, b: f64| (a.unwrap() - b).abs() < 1e-9;
        assert!(near(speed.depth, 50.0) && speed.pose.is_none() && near(speed.networks, 20.0) && speed.whole == 2.0);
        let told = "networks alone 20.0 frames/s (depth 50.0, flow 33.3), with reading and writing 2.0 frames/s, at 640x192";
        assert_eq!(speed.told(), told);
        let single = Clocks::default().speed((64, 64), 1, Duration::from_millis(500));
        assert_eq!(single.told(), "with reading and writing 2.0 frames/s, at 64x64");
    }
}
