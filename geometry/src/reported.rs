//! Numbers that the paper reports, and the arithmetic that they follow from (L63, L64).

/// How much smaller `after` is than `before`, percent: `100 (before - after) / before`.
#[must_use]
pub fn reduction_percent(before: f64, after: f64) -> f64 {
    100.0 * (before - after) / before
}

/// A reduction of the absolute trajectory error that the text names.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reduction {
    /// Error without the method, metres, from the table.
    pub before: f64,
    /// Error with it, metres, from the table.
    pub after: f64,
    /// Percentage in the text.
    pub percent: f64,
}

/// The four reductions.
pub const TRAJECTORY_REDUCTIONS: [Reduction; 4] = [
    Reduction { before: 43.17, after: 10.77, percent: 75.05 },
    Reduction { before: 50.72, after: 17.60, percent: 65.30 },
    Reduction { before: 13.51, after: 6.47, percent: 52.11 },
    Reduction { before: 22.03, after: 10.01, percent: 54.56 },
];

/// Triplets of the Eigen split: in the paper, and lines of the published list of that name (`splits/eigen_zhou`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SplitCount {
    /// Which part.
    pub part: &'static str,
    /// Number in the paper.
    pub printed: u32,
    /// Lines of the published list.
    pub listed: u32,
}

/// Both parts that the paper counts.
pub const EIGEN_SPLIT: [SplitCount; 2] = [
    SplitCount { part: "training", printed: 39_180, listed: 39_810 },
    SplitCount { part: "validation", printed: 4_424, listed: 4_424 },
];

/// Error of sequence 15 that the table prints bold, and the smaller one of DF-VO in the same column.
pub const BOLD_OF_SEQUENCE_15: (f64, f64) = (9.74, 6.57);

/// The two neighbouring digits that differ when one number is the other with two of its digits exchanged.
///
/// `None` when they differ otherwise.
#[must_use]
pub fn exchanged_digits(a: u32, b: u32) -> Option<(char, char)> {
    let (a, b): (Vec<_>, Vec<_>) = (a.to_string().chars().collect(), b.to_string().chars().collect());
    let differ: Vec<_> = if a.len() == b.len() { (0..a.len()).filter(|&i| a[i] != b[i]).collect() } else { Vec::new() };
    match differ[..] {
        [i, j] if j == i + 1 && a[i] == b[j] && a[j] == b[i] => Some((a[i], a[j])),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentages_of_round_numbers() {
        assert_eq!(reduction_percent(8.0, 2.0), 75.0);
        assert_eq!(reduction_percent(2.0, 3.0), -50.0);
    }

    #[test]
    fn exchanged_digits_are_neighbours() {
        assert_eq!(exchanged_digits(1234, 1324), Some(('2', '3')));
        assert_eq!(exchanged_digits(1234, 4231), None);
        assert_eq!(exchanged_digits(1234, 1235), None);
        assert_eq!(exchanged_digits(1234, 1234), None);
        assert_eq!(exchanged_digits(123, 1234), None);
    }
}
