//! Lines and numbers of small text files, with the place of every fault.

use std::fs;
use std::path::Path;

use super::DataError;

/// The text of a file, without a byte-order mark. `what` says in the error what was wanted.
pub(crate) fn read_text(path: &Path, what: &str) -> Result<String, DataError> {
    let bytes = fs::read(path).map_err(|error| DataError::read(path, what, error))?;
    let text = String::from_utf8(bytes)
        .map_err(|_| DataError::malformed(path, "not a text file (invalid UTF-8)", "check that this is the right file"))?;
    Ok(match text.strip_prefix('\u{feff}') {
        Some(rest) => rest.to_owned(),
        None => text,
    })
}

/// The lines that are not blank, trimmed, with their numbers from 1.
pub(crate) fn filled_lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    text.lines().enumerate().map(|(index, line)| (index + 1, line.trim())).filter(|(_, line)| !line.is_empty())
}

/// One finite number: decimal point, optional exponent; no decimal comma, no hexadecimal, no suffix.
pub(crate) fn parse_number(path: &Path, line: usize, token: &str) -> Result<f64, DataError> {
    let advice = "write plain decimal numbers such as 7.188560000000e+02";
    let value: f64 = token.parse().map_err(|_| DataError::at_line(path, line, format!("{token:?} is not a number"), advice))?;
    if value.is_finite() {
        Ok(value)
    } else {
        Err(DataError::at_line(path, line, format!("non-finite value {token}"), "repair or remove the file"))
    }
}

/// The finite numbers of a line, separated by blanks or tabs.
pub(crate) fn parse_numbers(path: &Path, line: usize, text: &str) -> Result<Vec<f64>, DataError> {
    text.split_whitespace().map(|token| parse_number(path, line, token)).collect()
}

/// Scientific notation with sign and two digits of exponent, `digits` after the point: `7.188560000e+02`.
pub(crate) fn scientific(value: f64, digits: usize) -> String {
    let text = format!("{value:.digits$e}");
    let (mantissa, exponent) = text.split_once('e').unwrap_or((&text, "0"));
    let (sign, size) = exponent.strip_prefix('-').map_or(('+', exponent), |size| ('-', size));
    format!("{mantissa}e{sign}{size:0>2}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn odd_but_harmless_text_is_accepted() {
        let lines: Vec<_> = filled_lines("\u{feff}1\t2  3 \r\n\r\n 4 5 6").collect();
        assert_eq!(lines, vec![(1, "1\t2  3"), (3, "4 5 6")]);
        assert_eq!(parse_numbers(Path::new("a"), 1, lines[0].1).unwrap(), vec![1.0, 2.0, 3.0]);
    }

    #[test]
    fn what_is_not_a_number_is_named() {
        for token in ["1,5", "1.0f", "0x10", "--1", "abc"] {
            let message = parse_number(Path::new("p.txt"), 4, token).unwrap_err().to_string();
            assert!(message.starts_with(&format!("p.txt:4: {token:?} is not a number")), "{message}");
        }
        for token in ["nan", "inf", "-inf", "1e999"] {
            let message = parse_number(Path::new("p.txt"), 4, token).unwrap_err().to_string();
            assert!(message.starts_with(&format!("p.txt:4: non-finite value {token}")), "{message}");
        }
    }

    #[test]
    fn scientific_notation_reads_back() {
        assert_eq!(scientific(718.856, 9), "7.188560000e+02");
        assert_eq!(scientific(-0.00125, 3), "-1.250e-03");
        assert_eq!(scientific(0.0, 2), "0.00e+00");
        assert_eq!(scientific(1.5e123, 1), "1.5e+123");
    }
}
