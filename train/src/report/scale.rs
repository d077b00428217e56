//! Axes: from values to positions, and where the ticks go.

/// A linear or logarithmic axis over a range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axis {
    /// Lower end.
    pub low: f64,
    /// Upper end, above the lower.
    pub high: f64,
    /// Logarithmic (both ends positive).
    pub log: bool,
}

impl Axis {
    /// An axis that shows all usable values with a little room; values that are not finite, and for a logarithmic axis
    /// values at or below zero, are ignored.
    pub fn around(values: impl Iterator<Item = f64>, log: bool) -> Self {
        let mut range = None::<(f64, f64)>;
        for value in values.filter(|v| v.is_finite() && (!log || *v > 0.0)) {
            let (low, high) = range.unwrap_or((value, value));
            range = Some((low.min(value), high.max(value)));
        }
        let (low, high) = range.unwrap_or(if log { (0.1, 1.0) } else { (0.0, 1.0) });
        if log {
            let room = (high / low).powf(0.05).max(1.1);
            return Self { low: low / room, high: high * room, log };
        }
        let span = high - low;
        let room = if span > 0.0 { 0.05 * span } else { 0.5 * low.abs().max(1e-6) };
        let keeps_zero = low >= 0.0 && low - room < 0.0;
        Self { low: if keeps_zero { 0.0 } else { low - room }, high: high + room, log }
    }

    /// Position of a value, 0 at the lower end and 1 at the upper; `None` when the axis cannot show it.
    pub fn position(&self, value: f64) -> Option<f64> {
        if !value.is_finite() || (self.log && value <= 0.0) {
            return None;
        }
        Some(if self.log {
            (value / self.low).ln() / (self.high / self.low).ln()
        } else {
            (value - self.low) / (self.high - self.low)
        })
    }

    /// About `count` round values within the range, with their labels.
    pub fn ticks(&self, count: usize) -> Vec<(f64, String)> {
        if self.log {
            let values = self.log_ticks(count);
            if values.len() >= 2 {
                return values.into_iter().map(|v| (v, label(v, v))).collect();
            }
        }
        let step = round_step((self.high - self.low) / count.max(1) as f64);
        let (first, last) = ((self.low / step).ceil() as i64, (self.high / step).floor() as i64);
        let values = (first..=last).map(|k| k as f64 * step);
        values.map(|v| (v, label(v, step))).collect()
    }

    fn log_ticks(&self, count: usize) -> Vec<f64> {
        let first = self.low.log10().floor() as i32;
        let last = self.high.log10().ceil() as i32;
        let all = |factors: &[f64], stride: usize| -> Vec<f64> {
            (first..=last)
                .step_by(stride)
                .flat_map(|e| factors.iter().map(move |f| f * 10f64.powi(e)))
                .filter(|v| *v >= self.low && *v <= self.high)
                .collect()
        };
        for factors in [&[1.0, 2.0, 5.0][..], &[1.0, 3.0][..], &[1.0][..]] {
            let ticks = all(factors, 1);
            if ticks.len() <= count.max(2) {
                return ticks;
            }
        }
        let stride = (last - first).max(1) as usize / count.max(1) + 1;
        all(&[1.0], stride)
    }
}

/// The round number (1, 2 or 5 times a power of ten) at or above `step`.
fn round_step(step: f64) -> f64 {
    let power = 10f64.powf(step.log10().floor());
    let rounds = [1.0, 2.0, 5.0, 10.0].into_iter();
    rounds.map(|f| f * power).find(|s| *s >= step * 0.999).unwrap_or(10.0 * power)
}

/// A number with as many decimals as steps of `step` need.
pub fn label(value: f64, step: f64) -> String {
    let size = value.abs().max(step.abs());
    if value == 0.0 || value.abs() < 1e-9 * step.abs() {
        return "0".to_owned();
    }
    if !(1e-3..1e6).contains(&size) {
        let text = format!("{value:.1e}");
        return text.replace(".0e", "e");
    }
    let decimals = (-step.abs().log10()).ceil().clamp(0.0, 6.0) as usize;
    format!("{value:.decimals$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(axis: Axis, count: usize) -> Vec<String> {
        axis.ticks(count).into_iter().map(|(_, text)| text).collect()
    }

    #[test]
    fn linear_ticks_are_round() {
        let axis = Axis { low: 0.0, high: 0.93, log: false };
        assert_eq!(labels(axis, 5), ["0", "0.2", "0.4", "0.6", "0.8"]);
        let axis = Axis { low: -3.2, high: 12.0, log: false };
        assert_eq!(labels(axis, 4), ["0", "5", "10"]);
        let axis = Axis { low: 0.0, high: 12_000.0, log: false };
        assert_eq!(labels(axis, 6), ["0", "2000", "4000", "6000", "8000", "10000", "12000"]);
    }

    #[test]
    fn log_ticks_adapt_to_the_range() {
        let axis = |low, high| Axis { low, high, log: true };
        assert_eq!(labels(axis(0.008, 1.1), 5), ["0.01", "0.03", "0.1", "0.3", "1"]);
        assert_eq!(labels(axis(0.1, 0.9), 5), ["0.1", "0.2", "0.5"]);
        assert_eq!(labels(axis(0.41, 0.49), 4).len(), 4);
        assert!(labels(axis(1e-12, 1e3), 5).len() <= 7);
    }

    #[test]
    fn positions_cover_zero_to_one() {
        let axis = Axis::around([1.0, 100.0].into_iter(), true);
        assert!((axis.position(10.0).unwrap() - 0.5).abs() < 1e-12);
        assert_eq!(axis.position(0.0), None);
        assert_eq!(axis.position(f64::NAN), None);
        let axis = Axis::around([0.0, 2.0].into_iter(), false);
        assert_eq!((axis.low, axis.high), (0.0, 2.1));
    }

    #[test]
    fn odd_data_still_give_an_axis() {
        let flat = Axis::around([3.0, 3.0].into_iter(), false);
        assert!(flat.high > flat.low && !flat.ticks(4).is_empty());
        let none = Axis::around([f64::NAN, -1.0].into_iter(), true);
        assert!(none.high > none.low);
        let zero = Axis::around([0.0].into_iter(), false);
        assert!(zero.high > zero.low);
    }

    #[test]
    fn tiny_and_huge_numbers_use_powers_of_ten() {
        assert_eq!(label(2e-5, 1e-5), "2e-5");
        assert_eq!(label(2.5e7, 5e6), "2.5e7");
        assert_eq!(label(0.25, 0.05), "0.25");
    }
}
