//! Repetitions, medians, spreads.

use std::time::Instant;

use crate::Ours;

/// Repetitions of one measurement at least and at most, after two that warm up; a peer takes as many.
const FEWEST: usize = 3;
const MOST: usize = 300;

/// Milliseconds of each repetition of `what`, for about `seconds`.
pub fn measure(ours: &mut dyn Ours, what: &str, seconds: f64) -> Vec<f64> {
    for _ in 0..2 {
        ours.repetition(what);
    }
    let (start, mut samples) = (Instant::now(), Vec::new());
    while samples.len() < FEWEST || (start.elapsed().as_secs_f64() < seconds && samples.len() < MOST) {
        samples.push(1e3 * ours.repetition(what).as_secs_f64());
    }
    samples
}

/// The middle of some numbers.
///
/// # Panics
/// When there is none.
pub fn median(numbers: &[f64]) -> f64 {
    let mut sorted = numbers.to_vec();
    sorted.sort_by(f64::total_cmp);
    let middle = sorted.len() / 2;
    if sorted.len() % 2 == 1 { sorted[middle] } else { 0.5 * (sorted[middle - 1] + sorted[middle]) }
}

/// The smallest and the largest of some numbers.
pub fn ends(numbers: &[f64]) -> (f64, f64) {
    numbers.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &x| (low.min(x), high.max(x)))
}

/// The geometric mean of positive numbers.
pub fn geometric_mean(numbers: &[f64]) -> f64 {
    (numbers.iter().map(|x| x.ln()).sum::<f64>() / numbers.len() as f64).exp()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn middles_ends_and_means() {
        assert_eq!((median(&[3.0, 1.0, 2.0]), median(&[4.0, 1.0, 2.0, 3.0])), (2.0, 2.5));
        assert_eq!(ends(&[3.0, 1.0, 2.0]), (1.0, 3.0));
        assert!((geometric_mean(&[2.0, 8.0]) - 4.0).abs() < 1e-12);
    }
}
