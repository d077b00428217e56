//! Files of frame times: one number of seconds a line.

use std::path::Path;

use super::DataError;
use super::text::{filled_lines, parse_number, read_text};

/// Reads a file of times: one number of seconds a line, increasing.
///
/// **Errors** name the line: not one finite number, not later than the line before.
pub fn read_times(path: &Path) -> Result<Vec<f64>, DataError> {
    parse_times(path, &read_text(path, "times file")?)
}

fn parse_times(path: &Path, text: &str) -> Result<Vec<f64>, DataError> {
    let mut times: Vec<f64> = Vec::new();
    for (line, content) in filled_lines(text) {
        let time = parse_number(path, line, content)?;
        if times.last().is_some_and(|&last| time <= last) {
            let reason = format!("not increasing ({time} after {})", times[times.len() - 1]);
            return Err(DataError::at_line(path, line, reason, "times are seconds in the order of the frames"));
        }
        times.push(time);
    }
    Ok(times)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn times_increase() {
        let times = |text: &str| parse_times(Path::new("times.txt"), text);
        assert_eq!(times("0\n1.036e-01\r\n\n0.2\n").unwrap(), [0.0, 0.1036, 0.2]);
        let message = times("0\n0.1\n0.05\n").unwrap_err().to_string();
        assert!(message.starts_with("times.txt:3: not increasing (0.05 after 0.1)"), "{message}");
        let message = times("0\n0.1 0.2\n").unwrap_err().to_string();
        assert!(message.starts_with("times.txt:2: \"0.1 0.2\" is not a number"), "{message}");
    }

    proptest! {
        #[test]
        fn any_text_is_an_error_or_increasing(text in "[-0-9eE. naif\n]{0,60}") {
            if let Ok(times) = parse_times(Path::new("t"), &text) {
                prop_assert!(times.windows(2).all(|pair| pair[0] < pair[1]));
            }
        }
    }
}
