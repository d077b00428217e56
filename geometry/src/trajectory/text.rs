//! Reading and writing of the text files, shared by both forms.

use std::path::Path;

use super::{StampedPose, Trajectory};
use crate::error::GeometryError;

pub(super) fn read(path: &Path) -> Result<String, GeometryError> {
    std::fs::read_to_string(path).map_err(|source| GeometryError::Io { path: path.to_owned(), source })
}

pub(super) fn write(path: &Path, text: &str) -> Result<(), GeometryError> {
    std::fs::write(path, text).map_err(|source| GeometryError::Io { path: path.to_owned(), source })
}

pub(super) fn parse_error(path: &Path, line: usize, reason: String) -> GeometryError {
    GeometryError::Parse { path: path.to_owned(), line, reason }
}

/// Lines with content and their numbers; blank lines and `#` comments are passed over.
pub(super) fn content_lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    text.lines().enumerate().map(|(i, line)| (i + 1, line.trim())).filter(|(_, line)| !line.is_empty() && !line.starts_with('#'))
}

pub(super) fn numbers(line: &str) -> Result<Vec<f64>, String> {
    line.split_whitespace()
        .map(|field| match field.parse::<f64>() {
            Ok(x) if x.is_finite() => Ok(x),
            _ => Err(format!("`{field}` is not a finite number")),
        })
        .collect()
}

/// Sorts by frame index; `lines[i]` is the line of pose `i`, needed only where an index can repeat.
pub(super) fn ordered(mut poses: Vec<StampedPose>, lines: &[usize], path: &Path) -> Result<Trajectory, GeometryError> {
    if poses.is_empty() {
        return Err(parse_error(path, 1, "no pose in the file".to_owned()));
    }
    let mut order: Vec<usize> = (0..poses.len()).collect();
    order.sort_by_key(|&i| poses[i].index);
    if let Some(w) = order.windows(2).find(|w| poses[w[0]].index == poses[w[1]].index) {
        let reason = format!("frame index {} appears more than once", poses[w[1]].index);
        let line = lines.get(w[1]).copied().unwrap_or(0);
        return Err(parse_error(path, line, reason));
    }
    poses.sort_by_key(|p| p.index);
    Ok(Trajectory { poses })
}

/// C-style `%.9e`: two digits of exponent, sign always written.
pub(super) fn scientific(x: f64) -> String {
    let text = format!("{x:.9e}");
    let (mantissa, exponent) = text.split_once('e').unwrap_or((&text, "0"));
    let exponent: i32 = exponent.parse().unwrap_or(0);
    let sign = if exponent < 0 { '-' } else { '+' };
    format!("{mantissa}e{sign}{:02}", exponent.abs())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_written_like_c() {
        assert_eq!(scientific(-1.5e-7), "-1.500000000e-07");
        assert_eq!(scientific(0.0), "0.000000000e+00");
        assert_eq!(scientific(12345.0), "1.234500000e+04");
    }
}
